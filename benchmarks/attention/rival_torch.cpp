#include <vector>

#include <ATen/Parallel.h>
#include <torch/script.h>

#include "rivals.hpp"

namespace dynslam::attention::bench {
namespace {

torch::jit::Module loaded(const std::string& stem) {
  torch::jit::Module module = torch::jit::load(stem + ".pt");
  module.eval();
  return torch::jit::optimize_for_inference(module);
}

class TorchLayer final : public Rival {
 public:
  TorchLayer(const std::string& stem, const SafeTensors& data) : module_(loaded(stem)) {
    for (const char* name : {"input0", "input1"}) {
      if (!data.contains(name)) continue;
      const NamedTensor& t = data.at(name);
      inputs_.emplace_back(
          torch::from_blob(const_cast<float*>(t.values.data()), t.shape, torch::kFloat).clone());
    }
  }
  void run() override {
    const torch::InferenceMode inference;
    output_ = module_.forward(inputs_).toTensor();
  }
  const float* output() override {
    output_ = output_.contiguous();
    return output_.data_ptr<float>();
  }

 private:
  torch::jit::Module module_;
  std::vector<torch::jit::IValue> inputs_;
  torch::Tensor output_;
};

}  // namespace

std::unique_ptr<Rival> make_torch(const std::string& stem, const SafeTensors& data) {
  at::set_num_threads(1);
  return std::make_unique<TorchLayer>(stem, data);
}

}  // namespace dynslam::attention::bench
