// ONNX Runtime, loaded when it is first asked for: a program runs where the library is not, and
// says so when somebody wants it.
#include <dlfcn.h>

#define ORT_API_MANUAL_INIT
#include <algorithm>

#include <onnxruntime_cxx_api.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

#include "segmentation/network.hpp"
#include "segmentation/onnxruntime_library.hpp"

namespace dynslam::segmentation {
namespace {

// The API of the library on this machine, or why there is none. Loaded once for the process and
// never unloaded, as its threads and allocators may outlive any network.
struct Runtime {
  const OrtApi* api = nullptr;
  std::string problem;
};

Runtime load_runtime(const std::vector<std::string>& libraries) {
  Runtime runtime;
  void* library = nullptr;
  for (const std::string& name : libraries) {
    library = dlopen(name.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (library != nullptr) break;
  }
  if (library == nullptr) {
    runtime.problem = "the library " + (libraries.empty() ? "" : libraries.back()) +
                      " was not found, or cannot be loaded";
    return runtime;
  }
  using GetBase = const OrtApiBase* (*)();
  const auto get_base = reinterpret_cast<GetBase>(dlsym(library, "OrtGetApiBase"));
  if (get_base == nullptr) {
    runtime.problem = "the library found has no OrtGetApiBase";
    return runtime;
  }
  runtime.api = get_base()->GetApi(ORT_API_VERSION);
  if (runtime.api == nullptr) {
    runtime.problem = std::string("the library found is version ") +
                      get_base()->GetVersionString() + ", built for 1." +
                      std::to_string(ORT_API_VERSION);
  }
  return runtime;
}

Runtime load_and_use_runtime() {
  Runtime runtime =
      load_runtime({DYNSLAM_ONNXRUNTIME_LIBRARY, "libonnxruntime.so", "libonnxruntime.so.1"});
  if (runtime.api != nullptr) Ort::InitApi(runtime.api);
  return runtime;
}

const Runtime& runtime() {
  static const Runtime loaded = load_and_use_runtime();
  return loaded;
}

void ORT_API_CALL be_silent(void*, OrtLoggingLevel, const char*, const char*, const char*,
                            const char*) {}

std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

class OnnxRuntimeNetwork final : public Network {
 public:
  OnnxRuntimeNetwork(const OnnxFile& file, InputSize size, int threads)
      : path_(file.path),
        env_(ORT_LOGGING_LEVEL_FATAL, "dynslam", be_silent, nullptr),
        memory_(Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault)),
        shape_{1, 3, size.height, size.width} {
    if (file.inputs[0].shape.size() == 3) shape_.erase(shape_.begin());
    Ort::SessionOptions options;
    options.SetGraphOptimizationLevel(GraphOptimizationLevel::ORT_ENABLE_ALL);
    options.SetIntraOpNumThreads(threads);
    options.SetInterOpNumThreads(1);
    // Idle threads sleep: the cores belong to tracking.
    options.AddConfigEntry("session.intra_op.allow_spinning", "0");
    options.AddConfigEntry("session.inter_op.allow_spinning", "0");
    session_ = Ort::Session(env_, file.bytes.data(), file.bytes.size(), options);
    Ort::AllocatorWithDefaultOptions allocator;
    input_ = session_.GetInputNameAllocated(0, allocator).get();
    for (std::size_t i = 0; i < session_.GetOutputCount(); ++i) {
      names_.push_back(session_.GetOutputNameAllocated(i, allocator).get());
    }
    for (const std::string& name : names_) name_pointers_.push_back(name.c_str());
  }

  const std::vector<NetworkOutput>& run(const float* input) override {
    try {
      std::size_t count = 1;
      for (const std::int64_t axis : shape_) count *= static_cast<std::size_t>(axis);
      const Ort::Value tensor = Ort::Value::CreateTensor<float>(
          memory_, const_cast<float*>(input), count, shape_.data(), shape_.size());
      const char* input_name = input_.c_str();
      values_ = session_.Run(Ort::RunOptions{nullptr}, &input_name, &tensor, 1,
                             name_pointers_.data(), name_pointers_.size());
    } catch (const Ort::Exception& error) {
      throw_io_error(path_, "ONNX Runtime cannot run this network: " + first_line(error.what()));
    }
    collect();
    return outputs_;
  }
  const char* backend() const override { return "onnxruntime"; }

 private:
  void collect() {
    outputs_.resize(values_.size());
    integers_.resize(values_.size());
    for (std::size_t i = 0; i < values_.size(); ++i) {
      const auto info = values_[i].GetTensorTypeAndShapeInfo();
      outputs_[i].name = names_[i];
      outputs_[i].shape = info.GetShape();
      if (info.GetElementType() == ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT) {
        outputs_[i].data = values_[i].GetTensorData<float>();
      } else if (info.GetElementType() == ONNX_TENSOR_ELEMENT_DATA_TYPE_INT64) {
        const std::int64_t* from = values_[i].GetTensorData<std::int64_t>();
        integers_[i].resize(info.GetElementCount());
        std::transform(from, from + integers_[i].size(), integers_[i].begin(),
                       [](std::int64_t value) { return static_cast<float>(value); });
        outputs_[i].data = integers_[i].data();
      } else {
        throw_io_error(path_,
                       "has the output " + names_[i] + " of another type; expected float or int64");
      }
    }
  }

  std::string path_;
  Ort::Env env_;
  Ort::MemoryInfo memory_;
  std::vector<std::int64_t> shape_;
  Ort::Session session_{nullptr};
  std::string input_;
  std::vector<std::string> names_;
  std::vector<const char*> name_pointers_;
  std::vector<Ort::Value> values_;
  std::vector<std::vector<float>> integers_;
  std::vector<NetworkOutput> outputs_;
};

}  // namespace

std::unique_ptr<Network> make_onnxruntime_network(const OnnxFile& file, InputSize size,
                                                  int threads) {
  if (runtime().api == nullptr) {
    throw_io_error(file.path, "cannot be run by the backend onnxruntime: " + runtime().problem);
  }
  try {
    return std::make_unique<OnnxRuntimeNetwork>(file, size, threads);
  } catch (const Ort::Exception& error) {
    throw_io_error(file.path, "ONNX Runtime cannot load this network: " + first_line(error.what()));
  }
}

std::string onnxruntime_problem(const std::vector<std::string>& libraries) {
  return load_runtime(libraries).problem;
}

bool backend_available(Backend backend) {
  return backend == Backend::kOpenCv || runtime().api != nullptr;
}

}  // namespace dynslam::segmentation
