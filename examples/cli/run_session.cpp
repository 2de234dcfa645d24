#include "run_session.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <optional>
#include <thread>
#include <utility>

#include <opencv2/core/utility.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/read_ahead.hpp"
#include "dynslam/loop/vocabulary_io.hpp"

#include "interruption.hpp"
#include "live_view.hpp"
#include "mask_source.hpp"
#include "memory.hpp"
#include "progress.hpp"
#include "support/demo.hpp"

namespace dynslam::cli {
namespace {

using Clock = std::chrono::steady_clock;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

factors::WeightMode weight_mode(const std::string& solver) {
  if (solver == "fixed") return factors::WeightMode::kFixed;
  if (solver == "joint") return factors::WeightMode::kJoint;
  return factors::WeightMode::kEliminated;
}

int count_rejected(const slam::System& system) {
  const std::vector<slam::FeatureVerdict> verdicts = system.features().verdicts;
  return static_cast<int>(
      std::count(verdicts.begin(), verdicts.end(), slam::FeatureVerdict::kRejected));
}

RowState state_of(slam::TrackingState state) {
  switch (state) {
    case slam::TrackingState::kNotInitialized:
      return RowState::kNotInitialized;
    case slam::TrackingState::kTracked:
      return RowState::kTracked;
    case slam::TrackingState::kRelocalized:
      return RowState::kRelocalized;
    case slam::TrackingState::kLost:
      break;
  }
  return RowState::kLost;
}

FrameRow empty_row(std::size_t index, double timestamp, RowState state) {
  FrameRow row;
  row.index = static_cast<std::uint32_t>(index);
  row.timestamp = timestamp;
  row.state = state;
  return row;
}

void add_result(const slam::FrameResult& result, FrameRow& row) {
  row.state = state_of(result.state);
  row.features = result.features;
  row.inliers = result.inliers;
  row.masked_share = result.masked_share;
  row.keyframe = result.keyframe;
  row.moving_features = result.moving_features;
  row.moving_share = result.moving_share;
  row.loops = static_cast<std::uint32_t>(result.loops);
  row.ms.extract = static_cast<float>(result.ms.extract);
  row.ms.match = static_cast<float>(result.ms.match);
  row.ms.geometry = static_cast<float>(result.ms.geometry);
  row.ms.optimize = static_cast<float>(result.ms.optimize);
  row.ms.map = static_cast<float>(result.ms.map + result.background.map);
  row.ms.loop = static_cast<float>(result.background.loop);
}

FrameRow process(const dataset::Frame& frame, MaskSource& masks, slam::System& system,
                 LiveView& view) {
  const Clock::time_point start = Clock::now();
  FrameRow row = empty_row(frame.index, frame.timestamp, RowState::kLost);
  const cv::Mat& mask = masks.update(frame, row);
  const slam::FrameResult result = system.track(examples::input_of(frame, mask));
  add_result(result, row);
  row.ms.total = static_cast<float>(milliseconds_since(start));
  row.rejected_features = count_rejected(system);
  view.add(frame, mask, row, result, system);
  return row;
}

// Returns when a camera would have delivered the frame; at once if that was earlier.
void wait_for_frame(const dataset::Sequence& sequence, std::size_t frame, Clock::time_point start) {
  const std::chrono::duration<double> arrival(sequence.timestamp(frame) - sequence.timestamp(0));
  std::this_thread::sleep_until(start + std::chrono::duration_cast<Clock::duration>(arrival));
}

// Whether a camera leaves the map long enough to itself after a frame to be finished by the next.
bool leaves_time_for_map(const dataset::Sequence& sequence, std::size_t frame) {
  constexpr double kWork = 0.2;  // seconds, of mapping after a keyframe
  return frame + 1 < sequence.size() &&
         sequence.timestamp(frame + 1) - sequence.timestamp(frame) > kWork;
}

// The newest frame that a camera has delivered by now, at least `next`.
std::size_t due_frame(const dataset::Sequence& sequence, std::size_t next,
                      Clock::time_point start) {
  const double now = std::chrono::duration<double>(Clock::now() - start).count();
  const double first = sequence.timestamp(0);
  while (next + 1 < sequence.size() && sequence.timestamp(next + 1) - first <= now) ++next;
  return next;
}

FrameRow missing_row(const dataset::Sequence& sequence, std::size_t index, RowState state) {
  return empty_row(index, sequence.timestamp(index), state);
}

// A first mask before the clock starts; an unreadable frame is met again, and counted, in the run.
void prepare(const dataset::Sequence& sequence, MaskSource& masks) {
  try {
    masks.prepare(sequence.read(0));
  } catch (const IoError&) {
  }
}

}  // namespace

const char* to_string(RowState state) {
  switch (state) {
    case RowState::kNotInitialized:
      return slam::to_string(slam::TrackingState::kNotInitialized);
    case RowState::kTracked:
      return slam::to_string(slam::TrackingState::kTracked);
    case RowState::kRelocalized:
      return slam::to_string(slam::TrackingState::kRelocalized);
    case RowState::kLost:
      return slam::to_string(slam::TrackingState::kLost);
    case RowState::kUnreadable:
      return "unreadable";
    case RowState::kDropped:
      return "dropped";
  }
  return "unknown";
}

void require_depth(const char* command, const dataset::Sequence& sequence) {
  if (sequence.sensor() == dataset::SensorKind::kRgbd) return;
  throw_invalid_argument(command, "sequence",
                         sequence.name() + ", " + dataset::to_string(sequence.sensor()),
                         "a sequence with depth images");
}

slam::Sensor choose_sensor(const RunFlags& flags, const dataset::Sequence& sequence) {
  const dataset::SensorKind there = sequence.sensor();
  const std::string has = dataset::to_string(there);
  const std::string wanted = flags.sensor.empty() ? has : flags.sensor;
  if (wanted == slam::to_string(slam::Sensor::kMono)) return slam::Sensor::kMono;
  require(wanted == has, "run", "--sensor", wanted, sequence.name() + " to have it; it is " + has);
  return there == dataset::SensorKind::kStereo ? slam::Sensor::kStereo : slam::Sensor::kRgbd;
}

slam::Composition composition_of(const RunFlags& flags) {
  slam::Composition system = slam::composition(flags.system);
  system.options.localize_only = flags.localize_only;
  system.options.tracking.orb.max_features = flags.features;
  system.options.threading =
      flags.sequential ? slam::Threading::kSequential : slam::Threading::kBackground;
  if (system.has(slam::Part::kWeights)) system.options.weights = weight_mode(flags.solver);
  for (const std::string& part : flags.without) system = system.without(slam::part_from_name(part));
  return system;
}

std::size_t RunOutcome::count(RowState state) const {
  return static_cast<std::size_t>(std::count_if(
      rows.begin(), rows.end(), [&](const FrameRow& row) { return row.state == state; }));
}

std::size_t RunOutcome::localized_after() const {
  std::size_t given = 0;
  for (const FrameRow& row : rows) {
    if (!row.processed()) continue;
    ++given;
    if (row.has_pose()) return given;
  }
  return 0;
}

RunOutcome run_system(const dataset::Sequence& sequence, const RunFlags& flags) {
  slam::SystemOptions options = composition_of(flags).options;
  options.sensor = choose_sensor(flags, sequence);
  if (flags.threads > 0) {
    // More than there are processors do nothing, and TBB says so on stderr.
    cv::setNumThreads(std::min(flags.threads, cv::getNumberOfCPUs()));
  } else if (flags.asynchronous()) {
    cv::setNumThreads(threads_beside_tracking());
  }
  RunOutcome outcome;
  loop::Vocabulary vocabulary;
  if (!flags.vocabulary.empty()) vocabulary = loop::load_vocabulary(flags.vocabulary);
  outcome.system =
      std::make_unique<slam::System>(sequence.camera(), options, std::move(vocabulary));
  if (!flags.load.empty()) outcome.system->start_from(slam::load_map(flags.load));
  MaskSource masks(flags, sequence);
  LiveView view(flags, sequence);
  if (flags.asynchronous()) prepare(sequence, masks);
  const bool paced = flags.realtime || flags.asynchronous();
  dataset::ReadAheadOptions reading;
  reading.pause_at_work = paced;  // a camera does not take tracking's cores
  dataset::ReadAhead frames(sequence, reading);
  Progress progress(flags.system, sequence.size());
  outcome.rows.reserve(sequence.size());  // a growing vector leaves holes in long runs
  const Clock::time_point start = Clock::now();
  for (std::size_t next = 0; next < sequence.size(); ++next) {
    if (flags.realtime) {
      const std::size_t due = due_frame(sequence, next, start);
      for (; next < due; ++next)
        outcome.rows.push_back(missing_row(sequence, next, RowState::kDropped));
      frames.skip_to(next);
    }
    if (paced) {
      frames.read_on();
      wait_for_frame(sequence, next, start);
    }
    while (next * 4 >= (outcome.memory_mb.size() + 1) * sequence.size()) {
      outcome.memory_mb.push_back(resident_memory_mb());
    }
    const std::optional<dataset::FrameResult> read = frames.next();
    if (!read) break;
    if (!read->frame) {
      outcome.problems.push_back(read->error);
      outcome.rows.push_back(missing_row(sequence, read->index, RowState::kUnreadable));
      continue;
    }
    outcome.rows.push_back(process(*read->frame, masks, *outcome.system, view));
    if (!paced && leaves_time_for_map(sequence, next)) outcome.system->finish();
    const FrameRow& row = outcome.rows.back();
    progress.update(next + 1, std::string(to_string(row.state)) + ", " +
                                  std::to_string(row.inliers) + " inliers");
    if (interrupted()) break;
  }
  outcome.memory_mb.push_back(resident_memory_mb());
  outcome.seconds = std::chrono::duration<double>(Clock::now() - start).count();
  if (outcome.problems.size() == sequence.size()) throw IoError(outcome.problems.front());
  outcome.system->finish();
  view.finish();
  outcome.unsegmented = masks.finish();
  outcome.trajectory = outcome.system->trajectory();
  return outcome;
}

}  // namespace dynslam::cli
