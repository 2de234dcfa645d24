// Segmenters by name, as the command line and configuration files give them.
#pragma once

#include <memory>
#include <string>

#include "dynslam/segmentation/segmenter.hpp"
#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

namespace dynslam::segmentation {

/// What a segmenter made by name is built with.
struct SegmenterFactoryOptions {
  NetworkOptions network;  ///< for the kinds that run a network
};

/// Makes a segmenter from "KIND" or "KIND:FILES":
///
///     none                           finds nothing
///     yolo-seg:MODEL.onnx            YOLOv5-seg, YOLOv8-seg or YOLO11-seg
///     recorded:FOLDER                masks from files, one PNG a frame
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
