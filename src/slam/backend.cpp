#include "backend.hpp"

#include <utility>

#include "stopwatch.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kMappingQueue = 2;  // keyframes that may wait for local mapping
constexpr std::size_t kLoopQueue = 64;    // for loop closing; more are not looked at

}  // namespace

Backend::Backend(const DepthCamera& camera, const SystemOptions& options,
                 const std::vector<float>& scale_factors, loop::Vocabulary vocabulary,
                 SharedMap& shared)
    : mapper_(camera, options, scale_factors, shared) {
  if (options.loops.enabled && factors::has_ceres()) {
    closer_ =
        std::make_unique<LoopCloser>(camera, options, scale_factors, std::move(vocabulary), shared);
  }
  if (options.threading == Threading::kSequential) return;
  if (closer_ != nullptr) {
    loops_ = std::make_unique<Worker>([this](KeyframeId id) { look_for_loop(id); }, kLoopQueue);
  }
  // A single camera's tracking lives on the points of the last keyframe: it has to wait for them.
  if (options.sensor == Sensor::kMono) return;
  mapping_ = std::make_unique<Worker>([this](KeyframeId id) { refine(id); }, kMappingQueue);
}

Backend::~Backend() { stop_ = true; }

void Backend::adopt_map() {
  mapper_.adopt_map();
  if (closer_ != nullptr) closer_->adopt_map();
}

bool Backend::accepts_keyframe() const { return mapping_ == nullptr || !mapping_->full(); }

KeyframeId Backend::insert(TrackedFrame& frame, std::size_t frame_index) {
  return mapper_.insert(frame, frame_index);
}

KeyframeId Backend::insert_start(const MonoStart& start, TrackedFrame& second,
                                 std::size_t frame_index) {
  return mapper_.insert_start(start, second, frame_index);
}

void Backend::process(KeyframeId keyframe) {
  if (mapping_ == nullptr) {
    refine(keyframe);
  } else {
    mapping_->post(keyframe);
  }
}

void Backend::refine(KeyframeId keyframe) {
  double ms = 0.0;
  {
    const ScopedTimer timer(ms);
    const bool in_time = mapping_ == nullptr || mapping_->waiting() == 0;
    mapper_.refine(keyframe, in_time, stop_);
  }
  add_time(&BackgroundTimes::map, ms);
  if (closer_ == nullptr) return;
  if (loops_ == nullptr) {
    look_for_loop(keyframe);
  } else {
    loops_->post(keyframe);
  }
}

void Backend::look_for_loop(KeyframeId keyframe) {
  double ms = 0.0;
  {
    const ScopedTimer timer(ms);
    closer_->process(keyframe, stop_);
  }
  add_time(&BackgroundTimes::loop, ms);
}

void Backend::finish() {
  if (mapping_ != nullptr) mapping_->wait_idle();
  if (loops_ != nullptr) loops_->wait_idle();
  rethrow_failure();
}

void Backend::rethrow_failure() const {
  for (const Worker* worker : {mapping_.get(), loops_.get()}) {
    if (worker == nullptr) continue;
    if (const std::exception_ptr failure = worker->failure()) std::rethrow_exception(failure);
  }
}

std::vector<KeyframeId> Backend::similar(const FrameFeatures& features, std::size_t count) const {
  if (closer_ == nullptr) return {};
  return closer_->database().similar(features, count);
}

const std::vector<LoopClosure>& Backend::closures() const {
  static const std::vector<LoopClosure> none;
  return closer_ == nullptr ? none : closer_->closures();
}

void Backend::add_time(double BackgroundTimes::*stage, double ms) {
  const std::lock_guard<std::mutex> guard(times_mutex_);
  times_.*stage += ms;
}

BackgroundTimes Backend::take_times() {
  const std::lock_guard<std::mutex> guard(times_mutex_);
  const BackgroundTimes times = times_;
  times_ = {};
  return times;
}

}  // namespace dynslam::slam
