#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/dnn.hpp>
#include <opencv2/dnn/layer.details.hpp>

#include "dynslam/attention/opencv.hpp"
#include "dynslam/core/errors.hpp"

#include "attention/flat_layer.hpp"

namespace dynslam::attention {
namespace {

/// Tasks in OpenCV's threads.
struct OpenCvThreads {
  void operator()(int count, Task task) const {
    cv::parallel_for_(cv::Range(0, count), [&](const cv::Range& range) {
      for (int i = range.start; i < range.end; ++i) task(i);
    });
  }
};

TensorBatch<float> batch_of(const cv::Mat& map) {
  CV_Assert(map.type() == CV_32F && map.dims == 4 && map.isContinuous());
  return {const_cast<float*>(map.ptr<float>()), map.size[0], map.size[1], map.size[2], map.size[3]};
}

/// One of the layers as OpenCV sees it: weights in its one blob, sizes in `layout`.
class FusedLayer final : public cv::dnn::Layer {
 public:
  explicit FusedLayer(const cv::dnn::LayerParams& params) : Layer(params) {
    const std::string op = params.type.substr(params.type.rfind('.') + 1);
    const cv::dnn::DictValue layout = params.get("layout");
    std::vector<std::int64_t> numbers;
    for (int i = 0; i < layout.size(); ++i) numbers.push_back(layout.get<int>(i));
    require(params.blobs.size() == 1 && params.blobs[0].type() == CV_32F &&
                params.blobs[0].isContinuous(),
            params.type, "weights", "none", "one float tensor");
    const cv::Mat& weights = params.blobs[0];
    layer_ = detail::make_layer(op, numbers, {weights.ptr<float>(), weights.total()});
    blobs.clear();  // the layer has its own copy, packed
  }

  static cv::Ptr<Layer> create(cv::dnn::LayerParams& params) {
    return cv::Ptr<Layer>(new FusedLayer(params));
  }

  bool getMemoryShapes(const std::vector<cv::dnn::MatShape>& inputs, const int /*requiredOutputs*/,
                       std::vector<cv::dnn::MatShape>& outputs,
                       std::vector<cv::dnn::MatShape>& /*internals*/) const override {
    require(static_cast<int>(inputs.size()) == layer_->inputs() && inputs[0].size() == 4, name,
            "inputs", inputs.size(), layer_->inputs());
    const auto strided = [&](int size) { return (size - 1) / layer_->stride() + 1; };
    outputs.assign(
        1, {inputs[0][0], layer_->out_channels(), strided(inputs[0][2]), strided(inputs[0][3])});
    return false;
  }

  void finalize(cv::InputArrayOfArrays inputs_array, cv::OutputArrayOfArrays) override {
    std::vector<cv::Mat> inputs;
    inputs_array.getMatVector(inputs);
    workspace_.reserve(
        layer_->workspace_size(inputs[0].size[2], inputs[0].size[3], cv::getNumThreads()));
  }

  void forward(cv::InputArrayOfArrays inputs_array, cv::OutputArrayOfArrays outputs_array,
               cv::OutputArrayOfArrays /*internals*/) override {
    std::vector<cv::Mat> inputs;
    std::vector<cv::Mat> outputs;
    inputs_array.getMatVector(inputs);
    outputs_array.getMatVector(outputs);
    TensorBatch<const float> views[2];
    for (std::size_t i = 0; i < inputs.size() && i < 2; ++i) views[i] = batch_of(inputs[i]);
    OpenCvThreads threads;
    const int tasks = cv::getNumThreads();
    layer_->run(views, batch_of(outputs[0]), workspace_,
                tasks > 1 ? Executor(threads, tasks) : Executor());
  }

  int64 getFLOPS(const std::vector<cv::dnn::MatShape>& /*inputs*/,
                 const std::vector<cv::dnn::MatShape>& /*outputs*/) const override {
    return 0;
  }

 private:
  std::unique_ptr<detail::AnyLayer> layer_;
  Workspace workspace_;
};

}  // namespace

void register_opencv_layers() {
  static std::once_flag once;
  std::call_once(once, [] {
    for (const std::string& op : detail::operator_names()) {
      cv::dnn::LayerFactory::registerLayer("dynslam." + op, FusedLayer::create);
    }
  });
}

}  // namespace dynslam::attention
