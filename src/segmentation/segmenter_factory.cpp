#include "dynslam/segmentation/segmenter_factory.hpp"

#include <cstdlib>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/network_segmenters.hpp"
#include "dynslam/segmentation/simple_segmenters.hpp"

namespace dynslam::segmentation {
namespace {

constexpr const char* kKinds =
    "none, yolo-seg:MODEL.onnx, yolo:MODEL.onnx, yolox:MODEL.onnx, darknet:NET.cfg,NET.weights, "
    "mask-rcnn:MODEL.onnx, mask-rcnn:GRAPH.pb,GRAPH.pbtxt, semantic:MODEL.onnx or recorded:FOLDER";

// Takes "@WIDTHxHEIGHT" off the end of a path.
void take_size(std::string& path, NetworkOptions& options) {
  const std::size_t at = path.rfind('@');
  if (at == std::string::npos) return;
  char* end = nullptr;
  const long width = std::strtol(path.c_str() + at + 1, &end, 10);
  if (*end != 'x') return;
  const long height = std::strtol(end + 1, &end, 10);
  if (*end != '\0' || width < 1 || height < 1 || width > 8192 || height > 8192) return;
  options.input_width = static_cast<int>(width);
  options.input_height = static_cast<int>(height);
  path.resize(at);
}

// Torchvision's ONNX file, or TensorFlow's graph with or without its text.
std::unique_ptr<Segmenter> make_mask_rcnn(const std::string& path, const NetworkOptions& options) {
  const std::string graph = path.substr(0, path.find(','));
  const bool tensorflow = graph.size() > 3 && graph.compare(graph.size() - 3, 3, ".pb") == 0;
  if (!tensorflow) return std::make_unique<MaskRcnnSegmenter>(path, options);
  const std::string config = graph.size() == path.size() ? "" : path.substr(graph.size() + 1);
  return std::make_unique<MaskRcnnTensorflowSegmenter>(graph, config, options);
}

std::unique_ptr<Segmenter> make_network_segmenter(const std::string& kind, std::string path,
                                                  NetworkOptions options) {
  take_size(path, options);
  if (kind == "yolo-seg") return std::make_unique<YoloSegSegmenter>(path, options);
  if (kind == "yolo") return std::make_unique<BoxSegmenter>(path, BoxNetwork::kYolo, options);
  if (kind == "yolox") return std::make_unique<BoxSegmenter>(path, BoxNetwork::kYolox, options);
  if (kind == "mask-rcnn") return make_mask_rcnn(path, options);
  if (kind == "semantic") return std::make_unique<SemanticSegmenter>(path, options);
  if (kind == "darknet") {
    const std::size_t comma = path.find(',');
    if (comma == std::string::npos) return nullptr;
    return std::make_unique<DarknetSegmenter>(path.substr(0, comma), path.substr(comma + 1),
                                              options);
  }
  return nullptr;
}

}  // namespace

std::unique_ptr<Segmenter> make_segmenter(const std::string& spec,
                                          const SegmenterFactoryOptions& options) {
  const std::size_t colon = spec.find(':');
  const std::string kind = spec.substr(0, colon);
  const std::string files = colon == std::string::npos ? "" : spec.substr(colon + 1);
  if (spec == "none") return std::make_unique<NullSegmenter>();
  std::unique_ptr<Segmenter> network;
  if (!files.empty()) {
    if (kind == "recorded") return std::make_unique<RecordedSegmenter>(files);
    options.network.validate();
    NetworkOptions inner = options.network;
    // Weak detections count where an instance is remembered.
    if (options.refine && options.refinement.bridge) inner.score_threshold /= 3.0F;
    network = make_network_segmenter(kind, files, inner);
  }
  if (network == nullptr) {
    throw_invalid_argument("make_segmenter", "spec", "\"" + spec + "\"", kKinds);
  }
  if (!options.refine) return network;
  RefinementOptions refinement = options.refinement;
  refinement.score = options.network.score_threshold;
  refinement.masks_from_boxes = kind == "yolo" || kind == "yolox" || kind == "darknet";
  return std::make_unique<RefinedSegmenter>(std::move(network), refinement);
}

Backend backend_from_name(const std::string& name) {
  if (name == "opencv") return Backend::kOpenCv;
  if (name == "onnxruntime") return Backend::kOnnxRuntime;
  throw_invalid_argument("backend_from_name", "name", "\"" + name + "\"", "opencv or onnxruntime");
}

}  // namespace dynslam::segmentation
