// The layers as custom operators of ONNX Runtime, through its C interface: nothing is linked, and
// whichever version the caller has loaded serves from 1.16 on.
#include <cstdint>
#include <exception>
#include <memory>
#include <string>
#include <vector>

#include <onnxruntime_c_api.h>

#include "dynslam/attention/onnxruntime.hpp"
#include "dynslam/core/errors.hpp"

#include "attention/flat_layer.hpp"

namespace dynslam::attention {
namespace {

// The first version with everything used here.
constexpr std::uint32_t kApiVersion = 16;

/// A failed call of ONNX Runtime inside a kernel; handed back to it by `guarded`.
class Failure : public std::exception {
 public:
  explicit Failure(OrtStatus* status) : status_(status) {}
  OrtStatus* status() const { return status_; }

 private:
  OrtStatus* status_;
};

void check(OrtStatus* status) {
  if (status != nullptr) throw Failure(status);
}

/// Runs `body`; what it throws becomes a status, as exceptions must not cross into the runtime.
template <typename Body>
OrtStatus* guarded(const OrtApi* api, const Body& body) {
  try {
    body();
    return nullptr;
  } catch (const Failure& failure) {
    return failure.status();
  } catch (const std::exception& error) {
    return api->CreateStatus(ORT_FAIL, error.what());
  }
}

/// Shape and values of a float tensor.
struct Values {
  std::vector<std::int64_t> shape;
  float* data = nullptr;
  std::size_t count = 0;
};

Values values_of(const OrtApi* api, const OrtValue* value) {
  Values values;
  OrtTensorTypeAndShapeInfo* info = nullptr;
  check(api->GetTensorTypeAndShape(value, &info));
  const std::unique_ptr<OrtTensorTypeAndShapeInfo, decltype(api->ReleaseTensorTypeAndShapeInfo)>
      release(info, api->ReleaseTensorTypeAndShapeInfo);
  std::size_t dimensions = 0;
  check(api->GetDimensionsCount(info, &dimensions));
  values.shape.resize(dimensions);
  check(api->GetDimensions(info, values.shape.data(), dimensions));
  check(api->GetTensorShapeElementCount(info, &values.count));
  void* data = nullptr;
  check(api->GetTensorMutableData(const_cast<OrtValue*>(value), &data));
  values.data = static_cast<float*>(data);
  return values;
}

TensorBatch<float> batch_of(const Values& values) {
  require(values.shape.size() == 4, "operator of dynslam", "input dimensions", values.shape.size(),
          4);
  int sizes[4];
  for (std::size_t i = 0; i < 4; ++i) {
    require(values.shape[i] > 0 && values.shape[i] <= (1 << 20), "operator of dynslam",
            "input shape", values.shape[i], "1..1048576");
    sizes[i] = static_cast<int>(values.shape[i]);
  }
  return {values.data, sizes[0], sizes[1], sizes[2], sizes[3]};
}

/// One operator, and the node of a session that runs it.
struct Operator : OrtCustomOp {
  std::string name;
  std::size_t inputs = 1;
};

struct Kernel {
  const OrtApi* api = nullptr;
  std::unique_ptr<detail::AnyLayer> layer;

  Kernel(const Operator& op, const OrtApi* api_, const OrtKernelInfo* info) : api(api_) {
    std::size_t size = 0;
    check(api->KernelInfoGetAttributeArray_int64(info, "layout", nullptr, &size));
    std::vector<std::int64_t> layout(size);
    check(api->KernelInfoGetAttributeArray_int64(info, "layout", layout.data(), &size));
    int constant = 0;
    const OrtValue* weights = nullptr;
    check(api->KernelInfoGetConstantInput_tensor(info, op.inputs, &constant, &weights));
    require(constant != 0 && weights != nullptr, "operator of dynslam", "weights",
            "a computed tensor", "a constant one");
    const Values values = values_of(api, weights);
    layer = detail::make_layer(op.name, layout, {values.data, values.count});
  }

  void compute(OrtKernelContext* context) const {
    TensorBatch<const float> inputs[2];
    for (std::size_t i = 0; i < static_cast<std::size_t>(layer->inputs()); ++i) {
      const OrtValue* value = nullptr;
      check(api->KernelContext_GetInput(context, i, &value));
      inputs[i] = batch_of(values_of(api, value));
    }
    const auto strided = [&](int size) { return (size - 1) / layer->stride() + 1; };
    const std::int64_t shape[4] = {inputs[0].batch, layer->out_channels(),
                                   strided(inputs[0].height), strided(inputs[0].width)};
    OrtValue* value = nullptr;
    check(api->KernelContext_GetOutput(context, 0, shape, 4, &value));
    // Sessions may run in several threads at once: the scratch is the thread's.
    thread_local Workspace workspace;
    layer->run(inputs, batch_of(values_of(api, value)), workspace, {});
  }
};

Operator make_operator(const std::string& name) {
  Operator op{};
  op.version = kApiVersion;
  op.name = name;
  op.inputs = name == "Dfc" ? 2 : 1;
  op.GetName = [](const OrtCustomOp* base) {
    return static_cast<const Operator*>(base)->name.c_str();
  };
  op.GetExecutionProviderType = [](const OrtCustomOp*) -> const char* { return nullptr; };
  op.GetInputType = [](const OrtCustomOp*, std::size_t) {
    return ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT;
  };
  op.GetInputTypeCount = [](const OrtCustomOp* base) {
    return static_cast<const Operator*>(base)->inputs + 1;
  };
  op.GetOutputType = op.GetInputType;
  op.GetOutputTypeCount = [](const OrtCustomOp*) { return std::size_t{1}; };
  op.GetInputCharacteristic = [](const OrtCustomOp*, std::size_t) { return INPUT_OUTPUT_REQUIRED; };
  op.GetOutputCharacteristic = op.GetInputCharacteristic;
  op.GetInputMemoryType = [](const OrtCustomOp*, std::size_t) { return OrtMemTypeDefault; };
  op.CreateKernelV2 = [](const OrtCustomOp* base, const OrtApi* api, const OrtKernelInfo* info,
                         void** kernel) -> OrtStatusPtr {
    return guarded(api,
                   [&] { *kernel = new Kernel(*static_cast<const Operator*>(base), api, info); });
  };
  op.KernelComputeV2 = [](void* kernel, OrtKernelContext* context) -> OrtStatusPtr {
    const auto* self = static_cast<const Kernel*>(kernel);
    return guarded(self->api, [&] { self->compute(context); });
  };
  op.KernelDestroy = [](void* kernel) { delete static_cast<Kernel*>(kernel); };
  return op;
}

/// The runtime keeps pointers to operators and domain as long as any session lives.
const std::vector<Operator>& operators() {
  static const std::vector<Operator> all = [] {
    std::vector<Operator> made;
    for (const std::string& name : detail::operator_names()) made.push_back(make_operator(name));
    return made;
  }();
  return all;
}

void require_ok(const OrtApi* api, OrtStatus* status) {
  if (status == nullptr) return;
  const std::string message = api->GetErrorMessage(status);
  api->ReleaseStatus(status);
  throw InvalidArgument("register_onnxruntime_operators: ONNX Runtime refused: " + message);
}

OrtCustomOpDomain* make_domain(const OrtApi* api) {
  OrtCustomOpDomain* domain = nullptr;
  require_ok(api, api->CreateCustomOpDomain("dynslam", &domain));
  for (const Operator& op : operators()) require_ok(api, api->CustomOpDomain_Add(domain, &op));
  return domain;
}

}  // namespace

bool has_onnxruntime_operators() { return true; }

void register_onnxruntime_operators(const OrtApiBase* api, OrtSessionOptions* options) {
  constexpr const char* kFunction = "register_onnxruntime_operators";
  require(api != nullptr, kFunction, "api", "null", "OrtGetApiBase()");
  require(options != nullptr, kFunction, "options", "null", "session options");
  const OrtApi* functions = api->GetApi(kApiVersion);
  if (functions == nullptr) {
    throw_invalid_argument(kFunction, "api", std::string("version ") + api->GetVersionString(),
                           "1.16 or newer");
  }
  // One for the process, never released: sessions refer to it.
  static OrtCustomOpDomain* const domain = make_domain(functions);
  require_ok(functions, functions->AddCustomOpDomain(options, domain));
}

}  // namespace dynslam::attention
