// What PyTorch exports, fused, inside ONNX Runtime's sessions.
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/attention/onnxruntime.hpp"
#include "dynslam/core/errors.hpp"

#ifdef DYNSLAM_WITH_ONNXRUNTIME
#include <onnxruntime_cxx_api.h>

#include "dynslam/attention/onnx_fuse.hpp"
#include "dynslam/attention/safetensors.hpp"

#include "attention/exported.hpp"
#include "attention/support.hpp"
#endif

namespace dynslam::attention {
namespace {

TEST(OnnxRuntimeOperators, RefuseNullPointers) {
  EXPECT_THROW(register_onnxruntime_operators(nullptr, nullptr), InvalidArgument);
}

#ifdef DYNSLAM_WITH_ONNXRUNTIME

TEST(OnnxRuntimeOperators, EqualPyTorch) {
  if (!testing::torch_is_here()) GTEST_SKIP() << "no python3 that can import torch was found";
  ASSERT_TRUE(has_onnxruntime_operators());
  Ort::Env env(ORT_LOGGING_LEVEL_ERROR, "test");
  for (const std::string name : {"small_dfc", "small_ghost", "small_bottleneck", "small_c3",
                                 "small_cbam", "small_cbam_spatial_first"}) {
    const std::string stem = testing::exported(name);
    ASSERT_FALSE(stem.empty());
    const OnnxFusion fusion = fuse_onnx(testing::bytes_of_file(stem + ".onnx"), stem);
    ASSERT_EQ(fusion.total(), 1) << name;
    Ort::SessionOptions options;
    options.SetIntraOpNumThreads(1);
    register_onnxruntime_operators(OrtGetApiBase(), options);
    Ort::Session session(env, fusion.bytes.data(), fusion.bytes.size(), options);

    const SafeTensors data = SafeTensors::read(stem + ".safetensors");
    const Ort::MemoryInfo memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
    std::vector<Ort::Value> inputs;
    const char* const input_names[] = {"input0", "input1"};
    const char* const output_names[] = {"output0"};
    for (const char* input : input_names) {
      if (!data.contains(input)) continue;
      const NamedTensor& t = data.at(input);
      inputs.push_back(Ort::Value::CreateTensor<float>(memory, const_cast<float*>(t.values.data()),
                                                       t.values.size(), t.shape.data(),
                                                       t.shape.size()));
    }
    const std::vector<Ort::Value> outputs =
        session.Run(Ort::RunOptions(), input_names, inputs.data(), inputs.size(), output_names, 1);
    const NamedTensor& expected = data.at("output0");
    const auto* got = outputs[0].GetTensorData<float>();
    EXPECT_LT(testing::relative_error({got, got + expected.values.size()},
                                      {expected.values.begin(), expected.values.end()}),
              testing::kTolerance)
        << name;
  }
}

#endif

}  // namespace
}  // namespace dynslam::attention
