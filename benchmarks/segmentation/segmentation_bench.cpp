// Decoding, masks, policy, refinement and carrying at the sizes of a real frame; the two backends
// on the real network where it is at hand. Every result is checked once before it is timed.
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <random>
#include <vector>

#include <benchmark/benchmark.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/segmentation/decoders/prototype_mask.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"
#include "dynslam/segmentation/depth_refinement.hpp"
#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/segmentation/mask_propagation.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

namespace dynslam::segmentation {
namespace {

constexpr int kWidth = 640, kHeight = 480, kClasses = 80, kCoefficients = 32, kInstances = 10;
constexpr int kRows = 3 * (80 * 60 + 40 * 30 + 20 * 15);

// Outputs of YOLOv5-seg at 480 x 640 with ten people side by side.
struct Outputs {
  std::vector<float> rows, prototypes;
  Outputs()
      : rows(static_cast<std::size_t>(kRows) * (5 + kClasses + kCoefficients)),
        prototypes(static_cast<std::size_t>(kCoefficients) * 120 * 160) {
    std::mt19937 random(1);
    std::normal_distribution<float> normal;
    for (float& value : prototypes) value = normal(random);
    // The first prototype is smooth, so that masks are blobs and not noise.
    for (int y = 0; y < 120; ++y) {
      for (int x = 0; x < 160; ++x) {
        prototypes[static_cast<std::size_t>(y * 160 + x)] =
            std::sin(static_cast<float>(x) * 0.2F) + std::cos(static_cast<float>(y) * 0.1F);
      }
    }
    for (int i = 0; i < kRows; ++i) {
      float* row = rows.data() + static_cast<std::ptrdiff_t>(i) * (5 + kClasses + kCoefficients);
      row[4] = 0.01F;
    }
    for (int i = 0; i < kInstances; ++i) {
      float* row =
          rows.data() + static_cast<std::ptrdiff_t>(i) * 1000 * (5 + kClasses + kCoefficients);
      row[0] = 60.0F + 57.0F * static_cast<float>(i);
      row[1] = 240.0F;
      row[2] = 110.0F;
      row[3] = 400.0F;
      row[4] = 0.9F;
      row[5] = 0.9F;
      row[5 + kClasses] = 4.0F;
      for (int c = 1; c < kCoefficients; ++c) row[5 + kClasses + c] = 0.05F;
    }
  }
  MatrixView matrix() const { return {rows.data(), 5 + kClasses + kCoefficients, kRows}; }
  TensorView<const float> protos() const { return {prototypes.data(), kCoefficients, 120, 160}; }
};

const Outputs& outputs() {
  static const Outputs made;
  return made;
}

Segmentation decode(PrototypeScratch& scratch, std::vector<Detection>& detections) {
  const Letterbox map = make_letterbox({kWidth, kHeight}, {kWidth, kHeight});
  const MatrixView matrix = outputs().matrix();
  detections.clear();
  decode_yolov5(matrix, kClasses, 0.3F, detections);
  suppress_non_maxima(detections, 0.45F, 100);
  Segmentation found;
  found.width = kWidth;
  found.height = kHeight;
  for (const Detection& detection : detections) {
    Instance instance;
    instance.box = map.to_image(detection);
    instance.score = detection.score;
    const Span<const float> coefficients(matrix.row(detection.index) + 5 + kClasses, kCoefficients);
    instance.mask = prototype_mask(outputs().protos(), coefficients, map, instance.box, scratch);
    found.instances.push_back(std::move(instance));
  }
  return found;
}

void decode_and_masks(benchmark::State& state) {
  PrototypeScratch scratch;
  std::vector<Detection> detections;
  if (decode(scratch, detections).instances.size() != kInstances) {
    state.SkipWithError("ten instances were expected");
    return;
  }
  for (auto _ : state) benchmark::DoNotOptimize(decode(scratch, detections));
}
BENCHMARK(decode_and_masks)->Unit(benchmark::kMillisecond);

// What most C++ ports do: all prototypes times all coefficients, sigmoid, scale, cut.
void rival_all_prototypes(benchmark::State& state) {
  const Letterbox map = make_letterbox({kWidth, kHeight}, {kWidth, kHeight});
  const MatrixView matrix = outputs().matrix();
  const cv::Mat protos(kCoefficients, 120 * 160, CV_32F,
                       const_cast<float*>(outputs().prototypes.data()));
  for (auto _ : state) {
    std::vector<Detection> detections;
    decode_yolov5(matrix, kClasses, 0.3F, detections);
    suppress_non_maxima(detections, 0.45F, 100);
    cv::Mat coefficients(static_cast<int>(detections.size()), kCoefficients, CV_32F);
    for (int i = 0; i < coefficients.rows; ++i) {
      const float* from = matrix.row(detections[static_cast<std::size_t>(i)].index) + 5 + kClasses;
      std::copy(from, from + kCoefficients, coefficients.ptr<float>(i));
    }
    const cv::Mat logits = coefficients * protos;
    for (int i = 0; i < logits.rows; ++i) {
      cv::Mat probability, large;
      cv::exp(-logits.row(i).reshape(1, 120), probability);
      probability = 1.0 / (1.0 + probability);
      cv::resize(probability, large, {kWidth, kHeight});
      const cv::Rect box = map.to_image(detections[static_cast<std::size_t>(i)]);
      benchmark::DoNotOptimize(cv::Mat(large(box) > 0.5));
    }
  }
}
BENCHMARK(rival_all_prototypes)->Unit(benchmark::kMillisecond);

void policy_with_dilation(benchmark::State& state) {
  PrototypeScratch scratch;
  std::vector<Detection> detections;
  const Segmentation found = decode(scratch, detections);
  MaskPolicyOptions options;
  options.dilation_px = static_cast<int>(state.range(0));
  const MaskPolicy policy(options);
  cv::Mat mask;
  for (auto _ : state) policy.mask(found, coco_class_names(), mask);
}
BENCHMARK(policy_with_dilation)->Arg(0)->Arg(3)->Arg(15)->Unit(benchmark::kMillisecond);

void rival_dilation_of_opencv(benchmark::State& state) {
  PrototypeScratch scratch;
  std::vector<Detection> detections;
  MaskPolicyOptions options;
  options.dilation_px = 0;
  const cv::Mat mask = MaskPolicy(options).mask(decode(scratch, detections), coco_class_names());
  const int size = 2 * static_cast<int>(state.range(0)) + 1;
  const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, {size, size});
  cv::Mat grown;
  for (auto _ : state) cv::dilate(mask, grown, disc);
}
BENCHMARK(rival_dilation_of_opencv)->Arg(3)->Arg(15)->Unit(benchmark::kMillisecond);

// Three people before a wall, moving 12 pixels a frame.
struct Walk {
  cv::Mat image, depth;
  Segmentation found;

  explicit Walk(int frame) {
    cv::Mat noise(kHeight, kWidth, CV_8UC1);
    cv::RNG(7).fill(noise, cv::RNG::UNIFORM, 0, 255);
    cv::GaussianBlur(noise, noise, {7, 7}, 2.0);
    cv::cvtColor(noise, image, cv::COLOR_GRAY2BGR);
    depth = cv::Mat(kHeight, kWidth, CV_32FC1, cv::Scalar(3.5F));
    found.width = kWidth;
    found.height = kHeight;
    for (int i = 0; i < 3; ++i) {
      const cv::Rect body(40 + 200 * i + 12 * frame, 60, 110, 400);
      cv::Mat cloth(body.size(), CV_8UC3);
      cv::RNG(static_cast<std::uint64_t>(i + 1)).fill(cloth, cv::RNG::UNIFORM, 0, 255);
      cv::GaussianBlur(cloth, cloth, {7, 7}, 1.5);
      cloth.copyTo(image(body));
      depth(body).setTo(1.5 + 0.5 * i);
      Instance instance;
      instance.score = 0.9F;
      instance.box = body + cv::Point(6, -6);
      instance.mask = cv::Mat(body.size(), CV_8UC1, cv::Scalar(255));
      found.instances.push_back(instance);
    }
  }
};

void refine_with_depth(benchmark::State& state) {
  const Walk walk(0);
  DepthRefiner refiner;
  for (auto _ : state) {
    Segmentation found = walk.found;
    refiner.refine(found, as_view<const float>(walk.depth));
    benchmark::DoNotOptimize(found);
  }
}
BENCHMARK(refine_with_depth)->Unit(benchmark::kMillisecond);

// One more frame for a mask that is already three frames old, as tracking sees it.
void carry_to_the_next_frame(benchmark::State& state) {
  std::vector<Walk> frames;
  for (int i = 0; i < 5; ++i) frames.emplace_back(i);
  const auto info = [&](std::size_t i) {
    FrameInfo frame;
    frame.index = i;
    frame.depth = as_view<const float>(frames[i].depth);
    return frame;
  };
  for (auto _ : state) {
    state.PauseTiming();
    MaskPropagator propagator;
    for (std::size_t i = 0; i < 4; ++i) propagator.add_frame(frames[i].image, info(i));
    propagator.set_segmentation(0, frames[0].found);
    benchmark::DoNotOptimize(propagator.current());
    state.ResumeTiming();
    propagator.add_frame(frames[4].image, info(4));
    benchmark::DoNotOptimize(propagator.current());
  }
}
BENCHMARK(carry_to_the_next_frame)->Unit(benchmark::kMillisecond);

void network(benchmark::State& state, const char* model, const char* backend) {
  const char* root = std::getenv("DYNSLAM_DATA");
  const std::filesystem::path path =
      std::filesystem::path(root != nullptr ? root : DYNSLAM_DEFAULT_DATA_DIR) / "models" / model;
  SegmenterFactoryOptions options;
  options.refine = false;
  options.network.backend = backend_from_name(backend);
  if (!std::filesystem::exists(path) || !backend_available(options.network.backend)) {
    state.SkipWithError("needs the shared data and the backend");
    return;
  }
  const auto segmenter = make_segmenter("yolo-seg:" + path.string(), options);
  const Walk walk(0);
  for (auto _ : state) benchmark::DoNotOptimize(segmenter->segment(walk.image, {}));
}
BENCHMARK_CAPTURE(network, v5n_480x640_opencv, "yolov5n-seg_480x640.onnx", "opencv")
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(network, v5n_480x640_onnxruntime, "yolov5n-seg_480x640.onnx", "onnxruntime")
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(network, v5n_256x320_opencv, "yolov5n-seg_256x320.onnx", "opencv")
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(network, v5n_256x320_onnxruntime, "yolov5n-seg_256x320.onnx", "onnxruntime")
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

}  // namespace
}  // namespace dynslam::segmentation
