#include "slam/faults.hpp"

#include <algorithm>
#include <iterator>
#include <limits>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace dynslam::slam::testing {
namespace {

struct KindFacts {
  const char* name;
  std::size_t least, most;  // frames that it lasts
};

constexpr KindFacts kFacts[] = {
    {"dropped", 1, 12},        {"black", 1, 15},      {"frozen", 1, 15},
    {"doubled", 1, 3},         {"noise", 1, 8},       {"no depth", 1, 30},
    {"NaN depth", 1, 30},      {"zero depth", 1, 30}, {"truncated", 1, 3},
    {"segmenter dies", 1, 40}, {"all masked", 1, 20}, {"time gap", 1, 1},
    {"time backward", 1, 3},   {"covered", 5, 60},    {"kidnapped", 1, 1},
};
static_assert(std::size(kFacts) == static_cast<std::size_t>(FaultKind::kCount));

constexpr double kGapSeconds = 10.0;
constexpr int kDilation = 10;             // pixels by which masks grow, as in `dynslam run`
constexpr std::size_t kKidnappedBy = 25;  // frames

cv::Mat noise_like(const cv::Mat& image, double low, double high, cv::RNG& rng) {
  cv::Mat noise(image.size(), image.type());
  rng.fill(noise, cv::RNG::UNIFORM, low, high);
  return noise;
}

}  // namespace

const char* to_string(FaultKind kind) { return kFacts[static_cast<std::size_t>(kind)].name; }

FrameInput clean_input(const dataset::Frame& frame) {
  cv::Mat mask;
  cv::dilate(frame.mask != 0, mask, cv::Mat(), cv::Point(-1, -1), kDilation);
  return {frame.timestamp, frame.color, frame.depth, mask};
}

FaultySource::FaultySource(const std::vector<dataset::Frame>& frames, std::uint64_t seed,
                           std::size_t quiet)
    : frames_(frames), random_(seed), end_(frames.size()) {
  const auto draw = [&](std::size_t low, std::size_t high) {
    return low + static_cast<std::size_t>(random_() % (high - low + 1));
  };
  std::size_t at = draw(0, 1) == 0 ? draw(0, quiet) : quiet;
  const std::size_t last = frames.size() - quiet;
  for (std::size_t n = draw(1, 4); n > 0 && at < last; --n) {
    Fault fault;
    fault.kind = static_cast<FaultKind>(draw(0, std::size(kFacts) - 1));
    const KindFacts& facts = kFacts[static_cast<std::size_t>(fault.kind)];
    fault.first = at + draw(0, 10);
    if (fault.first >= last) break;
    fault.count = std::min(draw(facts.least, facts.most), last - fault.first);
    faults_.push_back(fault);
    at = fault.first + fault.count + draw(0, 20);
  }
  if (draw(0, 3) == 0) end_ = draw(1, frames.size() - 1);
}

const Fault* FaultySource::fault_at(std::size_t index) const {
  for (const Fault& fault : faults_) {
    if (index >= fault.first && index < fault.first + fault.count) return &fault;
  }
  return nullptr;
}

std::string FaultySource::describe() const {
  std::string text;
  for (const Fault& fault : faults_) {
    text += std::string(to_string(fault.kind)) + " " + std::to_string(fault.first) + "+" +
            std::to_string(fault.count) + ", ";
  }
  return text + (runs_to_the_end() ? "to the end" : "stopped at " + std::to_string(end_));
}

void FaultySource::spoil(FaultyFrame& frame, const Fault& fault, std::size_t index) {
  FrameInput& input = frame.input;
  frame.disturbed = true;
  cv::RNG rng(random_());
  switch (fault.kind) {
    // New images, never expressions: those would be written into the sequence's own pixels.
    case FaultKind::kBlack:
      input.image = cv::Mat(input.image.size(), input.image.type(), cv::Scalar());
      break;
    case FaultKind::kFrozen:
      frame.shown = fault.first;
      input = clean_input(frames_[fault.first]);
      break;
    case FaultKind::kNoise:
      input.image = noise_like(input.image, 0, 256, rng);
      input.depth = noise_like(input.depth, 0.3, 8.0, rng);
      break;
    case FaultKind::kNoDepth:
      input.depth.release();
      break;
    case FaultKind::kNanDepth:
      input.depth = cv::Mat(input.depth.size(), CV_32FC1, std::numeric_limits<float>::quiet_NaN());
      break;
    case FaultKind::kZeroDepth:
      input.depth = cv::Mat(input.depth.size(), CV_32FC1, cv::Scalar());
      break;
    case FaultKind::kTruncated:
      input.image = input.image.rowRange(0, input.image.rows / 2).clone();
      frame.refused = true;
      break;
    case FaultKind::kSegmenterDies:
      input.mask.release();
      break;
    case FaultKind::kAllMasked:
      input.mask = cv::Mat(input.image.size(), CV_8UC1, cv::Scalar(255));
      break;
    case FaultKind::kCovered:
      input.image = cv::Mat(input.image.size(), input.image.type(), cv::Scalar());
      input.depth = cv::Mat(input.depth.size(), CV_32FC1, cv::Scalar());
      break;
    default:
      frame.disturbed = false;  // those that come between frames
  }
  input.timestamp = frames_[index].timestamp;
}

std::vector<FaultyFrame> FaultySource::frames() {
  std::vector<FaultyFrame> all;
  double delay = 0.0;
  for (std::size_t i = 0; i < end_; ++i) {
    const Fault* fault = fault_at(i);
    const bool begins = fault != nullptr && fault->first == i;
    if (fault != nullptr && fault->kind == FaultKind::kDropped) continue;
    if (begins && fault->kind == FaultKind::kTimeGap) delay += kGapSeconds;
    if (begins && fault->kind == FaultKind::kKidnapped) {
      i = std::min(i + kKidnappedBy, end_ - 1);
    }
    FaultyFrame frame;
    frame.shown = i;
    frame.input = clean_input(frames_[i]);
    if (fault != nullptr) spoil(frame, *fault, i);
    frame.input.timestamp += delay;
    all.push_back(frame);
    if (fault == nullptr) continue;
    if (fault->kind == FaultKind::kDoubled || fault->kind == FaultKind::kTimeBackward) {
      if (fault->kind == FaultKind::kTimeBackward) frame.input.timestamp -= 0.5;
      frame.refused = true;
      all.push_back(frame);
    }
  }
  return all;
}

}  // namespace dynslam::slam::testing
