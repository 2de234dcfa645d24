#include <unordered_map>
#include <utility>
#include <vector>

#include <dnnl.hpp>

#include "rivals.hpp"

namespace dynslam::attention::bench {
namespace {

using Arguments = std::unordered_map<int, dnnl::memory>;
using Dims = dnnl::memory::dims;
using Desc = dnnl::memory::desc;
using Tag = dnnl::memory::format_tag;
using Type = dnnl::memory::data_type;

constexpr auto kInference = dnnl::prop_kind::forward_inference;

/// The chain of GhostNetV2: pool, 1x1, 1x5, 5x1 with sigmoid, nearest, product.
class OneDnnDfc final : public Rival {
 public:
  OneDnnDfc(const SafeTensors& data, bool with_reorders)
      : engine_(dnnl::engine::kind::cpu, 0),
        stream_(engine_),
        with_reorders_(with_reorders),
        weights_(load_dfc(data, "weights.dfc.")) {
    const NamedTensor& x = data.at("input0");
    const NamedTensor& f = data.at("input1");
    const Dims in(x.shape.begin(), x.shape.end());
    const Dims out(f.shape.begin(), f.shape.end());
    const Dims half_in = {1, in[1], in[2] / 2, in[3] / 2};
    const Dims half = {1, out[1], in[2] / 2, in[3] / 2};
    const Desc blocked_in(in, Type::f32, Tag::nChw16c);
    const Desc blocked_out(out, Type::f32, Tag::nChw16c);

    input_ = dnnl::memory(blocked_in, engine_);
    features_ = dnnl::memory(blocked_out, engine_);
    enter(x, in, input_);
    enter(f, out, features_);

    const dnnl::pooling_forward::primitive_desc pool(
        {kInference, dnnl::algorithm::pooling_avg, blocked_in,
         Desc(half_in, Type::f32, Tag::nChw16c), Dims{2, 2}, Dims{2, 2}, Dims{0, 0}, Dims{0, 0}},
        engine_);
    dnnl::memory pooled(pool.dst_desc(), engine_);
    step(dnnl::pooling_forward(pool), {{DNNL_ARG_SRC, input_}, {DNNL_ARG_DST, pooled}});

    dnnl::memory map = convolve(weights_.pointwise, pooled, half, false, false);
    map = convolve(weights_.horizontal, map, half, true, false);
    map = convolve(weights_.vertical, map, half, true, true);

    const dnnl::resampling_forward::primitive_desc resample(
        {kInference, dnnl::algorithm::resampling_nearest, map.get_desc(), blocked_out}, engine_);
    dnnl::memory wide(blocked_out, engine_);
    step(dnnl::resampling_forward(resample), {{DNNL_ARG_SRC, map}, {DNNL_ARG_DST, wide}});

    const dnnl::binary::primitive_desc product(
        {dnnl::algorithm::binary_mul, blocked_out, blocked_out, blocked_out}, engine_);
    result_ = dnnl::memory(blocked_out, engine_);
    step(dnnl::binary(product),
         {{DNNL_ARG_SRC_0, features_}, {DNNL_ARG_SRC_1, wide}, {DNNL_ARG_DST, result_}});

    plain_ = dnnl::memory(Desc(out, Type::f32, Tag::nchw), engine_);
    leave_ = dnnl::reorder(result_, plain_);
  }

  void run() override {
    if (with_reorders_) {
      for (auto& [reorder, pair] : entries_) reorder.execute(stream_, pair.first, pair.second);
    }
    for (auto& [primitive, arguments] : steps_) primitive.execute(stream_, arguments);
    if (with_reorders_) leave_.execute(stream_, result_, plain_);
    stream_.wait();
  }
  const float* output() override {
    leave_.execute(stream_, result_, plain_);
    stream_.wait();
    return static_cast<const float*>(plain_.get_data_handle());
  }

 private:
  void step(dnnl::primitive primitive, Arguments arguments) {
    steps_.emplace_back(std::move(primitive), std::move(arguments));
  }

  void enter(const NamedTensor& tensor, const Dims& dims, dnnl::memory& blocked) {
    dnnl::memory plain(Desc(dims, Type::f32, Tag::nchw), engine_,
                       const_cast<float*>(tensor.values.data()));
    dnnl::reorder reorder(plain, blocked);
    reorder.execute(stream_, plain, blocked);
    stream_.wait();
    entries_.emplace_back(reorder, std::pair(plain, blocked));
  }

  dnnl::memory convolve(const Convolution& c, const dnnl::memory& source, const Dims& out,
                        bool depthwise, bool sigmoid) {
    const Dims shape = depthwise ? Dims{c.out_channels, 1, 1, c.kernel_height, c.kernel_width}
                                 : Dims{c.out_channels, c.group_channels, 1, 1};
    const Dims pad = {(c.kernel_height - 1) / 2, (c.kernel_width - 1) / 2};
    dnnl::primitive_attr attributes;
    if (sigmoid) {
      dnnl::post_ops post;
      post.append_eltwise(1.0F, dnnl::algorithm::eltwise_logistic, 0.0F, 0.0F);
      attributes.set_post_ops(post);
    }
    const dnnl::convolution_forward::primitive_desc conv(
        {kInference, dnnl::algorithm::convolution_auto, source.get_desc(),
         Desc(shape, Type::f32, Tag::any), Desc({c.out_channels}, Type::f32, Tag::x),
         Desc(out, Type::f32, Tag::nChw16c), Dims{1, 1}, pad, pad},
        attributes, engine_);
    dnnl::memory plain(Desc(shape, Type::f32, depthwise ? Tag::goihw : Tag::oihw), engine_,
                       const_cast<float*>(c.weight.data()));
    dnnl::memory weights(conv.weights_desc(), engine_);
    dnnl::reorder(plain, weights).execute(stream_, plain, weights);
    const dnnl::memory bias(Desc({c.out_channels}, Type::f32, Tag::x), engine_,
                            const_cast<float*>(c.bias.data()));
    dnnl::memory to(conv.dst_desc(), engine_);
    stream_.wait();
    step(dnnl::convolution_forward(conv), {{DNNL_ARG_SRC, source},
                                           {DNNL_ARG_WEIGHTS, weights},
                                           {DNNL_ARG_BIAS, bias},
                                           {DNNL_ARG_DST, to}});
    return to;
  }

  dnnl::engine engine_;
  dnnl::stream stream_;
  bool with_reorders_;
  DfcWeights weights_;
  dnnl::memory input_, features_, result_, plain_;
  dnnl::reorder leave_;
  std::vector<std::pair<dnnl::reorder, std::pair<dnnl::memory, dnnl::memory>>> entries_;
  std::vector<std::pair<dnnl::primitive, Arguments>> steps_;
};

}  // namespace

std::unique_ptr<Rival> make_onednn_dfc(const SafeTensors& data, bool with_reorders) {
  return std::make_unique<OneDnnDfc>(data, with_reorders);
}

}  // namespace dynslam::attention::bench
