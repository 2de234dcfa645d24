#include "mask_source.hpp"

#include <algorithm>
#include <chrono>
#include <iostream>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "dynslam/segmentation/segmenter_factory.hpp"

#include "support/demo.hpp"
#include "support/truth_segmenter.hpp"

namespace dynslam::cli {
namespace {

using Clock = std::chrono::steady_clock;

// Longest wait for a mask; a network warms up in less.
constexpr std::chrono::seconds kPatience{30};
constexpr const char* kTruth = "truth";
constexpr int kOldestMask = 15;  // frames, as the propagator has it

segmentation::MaskPolicyOptions policy_options(const RunFlags& flags) {
  segmentation::MaskPolicyOptions options;
  if (!flags.classes.empty()) options.classes = flags.classes;
  options.min_score = static_cast<float>(flags.min_score);
  options.dilation_px = flags.dilation_px;
  return options;
}

std::unique_ptr<segmentation::Segmenter> open_segmenter(const RunFlags& flags,
                                                        const dataset::Sequence& sequence) {
  if (flags.segmenter == kTruth) return std::make_unique<examples::TruthSegmenter>(sequence);
  segmentation::SegmenterFactoryOptions options;
  options.network.backend = segmentation::backend_from_name(flags.backend);
  if (flags.asynchronous()) options.network.threads = threads_beside_tracking();
  return segmentation::make_segmenter(flags.segmenter, options);
}

}  // namespace

void add_segmenter_flags(CLI::App& command, RunFlags& flags) {
  command
      .add_option(
          "--segmenter", flags.segmenter,
          "none, truth (the sequence's own masks), yolo-seg:MODEL.onnx, recorded:FOLDER ...")
      ->capture_default_str();
  command.add_option("--backend", flags.backend, "what runs the network")
      ->check(CLI::IsMember({"opencv", "onnxruntime"}))
      ->capture_default_str();
  command
      .add_option("--classes", flags.classes,
                  "classes that may move; default: people, vehicles, animals")
      ->delimiter(',');
  command.add_option("--min-score", flags.min_score, "instances below are ignored")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command.add_option("--dilation", flags.dilation_px, "pixels by which masks grow")
      ->check(CLI::Range(0, 100))
      ->capture_default_str();
  command.add_option("--segment-every", flags.segment_every, "a mask serves N frames")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
}

int threads_beside_tracking() {
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()) / 2);
}

MaskSource::MaskSource(const RunFlags& flags, const dataset::Sequence& sequence)
    : every_(flags.segment_every), policy_(policy_options(flags)) {
  if (flags.segmenter == "none" || !composition_of(flags).masks) return;
  std::unique_ptr<segmentation::Segmenter> segmenter = open_segmenter(flags, sequence);
  names_ = segmenter->class_names();
  // The truth came with the frame: to read or render that again is not segmentation's time.
  truth_ = flags.segmenter == kTruth && !flags.asynchronous();
  if (truth_) return;
  segmentation::AsyncOptions options;
  options.patience = kPatience;
  if (!flags.asynchronous()) options.niceness = 0;  // tracking waits
  worker_ = std::make_unique<segmentation::AsyncSegmenter>(std::move(segmenter), options);
  if (flags.asynchronous()) propagator_ = std::make_unique<segmentation::MaskPropagator>();
}

void MaskSource::prepare(const dataset::Frame& first) {
  if (!propagator_) return;
  worker_->submit(first.color, examples::info_of(first));
  worker_->wait_idle(kPatience);
}

const cv::Mat& MaskSource::update(const dataset::Frame& frame, FrameRow& row) {
  const Clock::time_point start = Clock::now();
  row.mask_age = -1;
  if (propagator_) {
    update_beside(frame, row);
  } else if (worker_ || truth_) {
    update_now(frame, row);
  }
  row.ms.segment = std::chrono::duration<float, std::milli>(Clock::now() - start).count();
  return mask_;
}

void MaskSource::update_now(const dataset::Frame& frame, FrameRow& row) {
  if (mask_.empty() || ++age_ >= every_) segment(frame);
  row.mask_age = mask_.empty() ? -1 : age_;
}

// A segmenter that fails leaves the last mask in place until that is of no use.
void MaskSource::segment(const dataset::Frame& frame) {
  if (const std::optional<segmentation::Segmentation> found = segmentation_of(frame)) {
    policy_.mask(*found, names_, mask_);
    age_ = 0;
    return;
  }
  ++failures_;
  if (age_ >= std::max(every_, kOldestMask)) mask_.release();
}

// Nothing if the segmenter fails, or if it still hangs at an earlier frame.
std::optional<segmentation::Segmentation> MaskSource::segmentation_of(const dataset::Frame& frame) {
  if (truth_) return examples::true_segmentation(frame);
  if (worker_->status().overdue) return std::nullopt;
  worker_->submit(frame.color, examples::info_of(frame));
  while (std::optional<segmentation::AsyncResult> result = worker_->wait(kPatience)) {
    if (result->index == frame.index) return std::move(result->segmentation);
  }
  return std::nullopt;
}

SegmenterFailures MaskSource::finish() {
  if (!worker_) return {};
  const bool hangs = !worker_->finish();
  const segmentation::AsyncStatus status = worker_->status();
  SegmenterFailures failures{failures_, status.last_error};
  if (propagator_) failures.count = static_cast<std::size_t>(status.failed) + (hangs ? 1 : 0);
  if (hangs) {
    failures.message = "no answer to frame " + std::to_string(status.busy_index) + " within " +
                       std::to_string(kPatience.count()) + " s";
  }
  return failures;
}

void tell(const SegmenterFailures& failures) {
  if (failures.count == 0) return;
  std::cerr << "dynslam: segmenter failed at " << failures.count << " frames: " << failures.message
            << '\n';
}

void MaskSource::update_beside(const dataset::Frame& frame, FrameRow& row) {
  propagator_->add_frame_shared(frame.color, frame.depth, examples::info_of(frame));
  while (std::optional<segmentation::AsyncResult> result = worker_->take()) {
    // Only what the mask will be made of is worth carrying.
    segmentation::Segmentation& found = result->segmentation;
    std::vector<segmentation::Instance> movers;
    for (const std::size_t i : policy_.dynamic_instances(found, names_)) {
      movers.push_back(std::move(found.instances[i]));
    }
    found.instances = std::move(movers);
    propagator_->set_segmentation(result->index, std::move(found));
  }
  worker_->submit_shared(frame.color, frame.depth, examples::info_of(frame));
  const std::optional<segmentation::PropagatedSegmentation> carried = propagator_->current();
  if (!carried) {
    mask_.release();
    return;
  }
  policy_.mask(carried->segmentation, names_, mask_);
  row.mask_age = carried->age;
}

}  // namespace dynslam::cli
