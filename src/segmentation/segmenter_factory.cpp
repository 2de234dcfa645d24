#include "dynslam/segmentation/segmenter_factory.hpp"

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/simple_segmenters.hpp"

namespace dynslam::segmentation {
namespace {

constexpr const char* kKinds = "none, yolo-seg:MODEL.onnx or recorded:FOLDER";

}  // namespace

std::unique_ptr<Segmenter> make_segmenter(const std::string& spec,
                                          const SegmenterFactoryOptions& options) {
  const std::size_t colon = spec.find(':');
  const std::string kind = spec.substr(0, colon);
  const std::string files = colon == std::string::npos ? "" : spec.substr(colon + 1);
  if (spec == "none") return std::make_unique<NullSegmenter>();
  if (!files.empty()) {
    if (kind == "recorded") return std::make_unique<RecordedSegmenter>(files);
    if (kind == "yolo-seg") return std::make_unique<YoloSegSegmenter>(files, options.network);
  }
  throw_invalid_argument("make_segmenter", "spec", "\"" + spec + "\"", kKinds);
}

Backend backend_from_name(const std::string& name) {
  if (name == "opencv") return Backend::kOpenCv;
  if (name == "onnxruntime") return Backend::kOnnxRuntime;
  throw_invalid_argument("backend_from_name", "name", "\"" + name + "\"", "opencv or onnxruntime");
}

}  // namespace dynslam::segmentation
