// Segmenters by name, as the command line and configuration files give them.
#pragma once

#include <memory>
#include <string>

#include "dynslam/segmentation/refined_segmenter.hpp"
#include "dynslam/segmentation/segmenter.hpp"
#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

namespace dynslam::segmentation {

/// What a segmenter made by name is built with.
struct SegmenterFactoryOptions {
  NetworkOptions network;  ///< for the kinds that run a network
  /// Put a RefinedSegmenter around a network. Its `score` is the network's `score_threshold`, and
  /// the network then gives everything from a third of that on.
  bool refine = true;
  RefinementOptions refinement;  ///< `score` and `masks_from_boxes` are set by the kind
};

/// Makes a segmenter from "KIND" or "KIND:FILES":
///
///     none                           finds nothing
///     yolo-seg:MODEL.onnx            YOLOv5-seg, YOLOv8-seg or YOLO11-seg
///     yolo:MODEL.onnx                YOLOv5, v8 or 11 without masks: boxes, masks from depth
///     yolox:MODEL.onnx               YOLOX: boxes, masks from depth
///     darknet:NET.cfg,NET.weights    YOLOv4-tiny and the like: boxes, masks from depth
///     mask-rcnn:MODEL.onnx           Mask R-CNN of torchvision (needs ONNX Runtime)
///     mask-rcnn:GRAPH.pb,GRAPH.pbtxt Mask R-CNN of TensorFlow, as OpenCV reads it
///     semantic:MODEL.onnx            DeepLab and the like
///     recorded:FOLDER                masks from files, one PNG a frame
///
/// A model whose file leaves its input size open takes it after its name:
/// "yolo-seg:M.onnx@640x480".
///
/// Throws InvalidArgument, listing the valid kinds, for any other text; and
/// what the constructor of the segmenter throws.
std::unique_ptr<Segmenter> make_segmenter(const std::string& spec,
                                          const SegmenterFactoryOptions& options = {});

/// "opencv" or "onnxruntime"; throws InvalidArgument for any other text.
Backend backend_from_name(const std::string& name);

/// Whether this build of the library can run the backend.
bool backend_available(Backend backend);

}  // namespace dynslam::segmentation
