#include <fstream>
#include <iterator>
#include <vector>

#include <onnxruntime_cxx_api.h>

#include "dynslam/attention/onnx_fuse.hpp"
#include "dynslam/attention/onnxruntime.hpp"

#include "rivals.hpp"

namespace dynslam::attention::bench {
namespace {

class OnnxRuntimeLayer final : public Rival {
 public:
  OnnxRuntimeLayer(const std::string& stem, const SafeTensors& data, bool fused)
      : memory_(Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault)) {
    static Ort::Env env(ORT_LOGGING_LEVEL_ERROR, "bench");
    std::ifstream stream(stem + ".onnx", std::ios::binary);
    std::string bytes{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
    Ort::SessionOptions options;
    options.SetIntraOpNumThreads(1);
    options.SetInterOpNumThreads(1);
    options.SetGraphOptimizationLevel(ORT_ENABLE_ALL);
    if (fused) {
      bytes = fuse_onnx({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, stem)
                  .bytes;
      register_onnxruntime_operators(OrtGetApiBase(), options);
    }
    session_ = Ort::Session(env, bytes.data(), bytes.size(), options);
    for (const char* name : {"input0", "input1"}) {
      if (!data.contains(name)) continue;
      const NamedTensor& t = data.at(name);
      inputs_.push_back(
          Ort::Value::CreateTensor<float>(memory_, const_cast<float*>(t.values.data()),
                                          t.values.size(), t.shape.data(), t.shape.size()));
    }
  }
  void run() override {
    const char* const inputs[] = {"input0", "input1"};
    const char* const outputs[] = {"output0"};
    outputs_ = session_.Run(Ort::RunOptions(), inputs, inputs_.data(), inputs_.size(), outputs, 1);
  }
  const float* output() override { return outputs_[0].GetTensorData<float>(); }

 private:
  Ort::MemoryInfo memory_;
  Ort::Session session_{nullptr};
  std::vector<Ort::Value> inputs_;
  std::vector<Ort::Value> outputs_;
};

}  // namespace

std::unique_ptr<Rival> make_onnxruntime(const std::string& stem, const SafeTensors& data,
                                        bool fused) {
  return std::make_unique<OnnxRuntimeLayer>(stem, data, fused);
}

}  // namespace dynslam::attention::bench
