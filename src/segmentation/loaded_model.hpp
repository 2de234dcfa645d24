// What all segmenters with an ONNX file share: load, fill the input, run.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "dynslam/segmentation/letterbox.hpp"

#include "segmentation/network.hpp"
#include "segmentation/stopwatch.hpp"

namespace dynslam::segmentation {

struct LoadedModel {
  NetworkOptions options;
  OnnxFile file;  ///< without its bytes
  InputSize size;
  std::unique_ptr<Network> network;
  std::vector<std::string> names;
  SegmenterInfo info;
  std::vector<float> blob;
  std::vector<cv::Mat> planes;

  /// Loads the file and runs it once, on grey; the outputs of that.
  const std::vector<NetworkOutput>& load(const std::string& path, const NetworkOptions& wanted);

  /// Letterboxes the image, runs the network; sets the size and the time in `result`.
  const std::vector<NetworkOutput>& run(const cv::Mat& image, const Letterbox& letterbox,
                                        const PixelScale& pixels, Segmentation& result);

  Letterbox letterbox(const cv::Mat& image, LetterboxPlace place) const {
    return make_letterbox(image.size(), cv::Size(size.width, size.height), place);
  }

  /// Throws IoError: the outputs found, and what was expected.
  [[noreturn]] void refuse_outputs(const std::vector<NetworkOutput>& outputs,
                                   const std::string& expected) const;
};

/// Names and shapes.
std::vector<TensorInfo> describe(const std::vector<NetworkOutput>& outputs);

/// Whether a detection output of three dimensions has a candidate a column (YOLOv8 and later)
/// rather than a row (YOLOv5): told by the number of grid cells, else by there being more
/// candidates than values of each.
bool candidates_are_columns(const std::vector<std::int64_t>& shape, InputSize size);

/// Instances whose mask is the box.
std::vector<Instance> box_instances(const std::vector<Detection>& detections,
                                    const Letterbox& letterbox);

}  // namespace dynslam::segmentation
