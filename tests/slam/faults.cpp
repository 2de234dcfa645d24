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
    {"dropped", 1, 12},        {"black", 1, 15},        {"frozen", 1, 15},
    {"doubled", 1, 3},         {"noise", 1, 8},         {"no depth", 1, 30},
    {"NaN depth", 1, 30},      {"zero depth", 1, 30},   {"truncated", 1, 3},
    {"segmenter dies", 1, 40}, {"all masked", 1, 20},   {"time gap", 1, 1},
    {"time backward", 1, 3},   {"covered", 5, 60},      {"kidnapped", 1, 1},
    {"half black", 1, 15},     {"white", 1, 10},        {"dim", 1, 30},
    {"blurred", 1, 10},        {"other size", 1, 3},    {"other type", 1, 3},
    {"wild depth", 1, 30},     {"sparse depth", 1, 30}, {"late depth", 1, 10},
    {"wrong units", 1, 5},     {"noise mask", 1, 20},   {"inverted mask", 1, 10},
    {"late mask", 1, 30},      {"wrong mask", 1, 3},    {"NaN time", 1, 3},
};
static_assert(std::size(kFacts) == static_cast<std::size_t>(FaultKind::kCount));

constexpr double kGapSeconds = 10.0;
constexpr int kDilation = 10;             // pixels by which masks grow, as in `dynslam run`
constexpr std::size_t kKidnappedBy = 25;  // frames
constexpr std::size_t kLateBy = 10;

cv::Mat noise_like(const cv::Mat& image, double low, double high, std::uint64_t seed) {
  cv::Mat noise(image.size(), image.type());
  cv::RNG rng(seed);
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
                           std::size_t quiet, FaultRate rate)
    : frames_(frames), random_(seed), end_(frames.size()) {
  const auto draw = [&](std::size_t low, std::size_t high) {
    return low + static_cast<std::size_t>(random_() % (high - low + 1));
  };
  std::size_t at = draw(0, 1) == 0 ? draw(0, quiet) : quiet;
  const std::size_t last = frames.size() - quiet;
  const bool harsh = rate == FaultRate::kHarsh;
  for (std::size_t n = harsh ? draw(5, 15) : draw(1, 4); n > 0 && at < last; --n) {
    Fault fault;
    fault.kind = static_cast<FaultKind>(draw(0, std::size(kFacts) - 1));
    const KindFacts& facts = kFacts[static_cast<std::size_t>(fault.kind)];
    fault.first = at + draw(0, harsh ? 2 : 10);
    if (fault.first >= last) break;
    fault.count = std::min(draw(facts.least, facts.most), last - fault.first);
    faults_.push_back(fault);
    at = fault.first + fault.count + draw(0, harsh ? 4 : 20);
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

// New images, never expressions: those would be written into the sequence's own pixels.
void FaultySource::spoil_image(FaultyFrame& frame, FaultKind kind) {
  cv::Mat& image = frame.input.image;
  const cv::Mat before = image;
  switch (kind) {
    case FaultKind::kBlack:
    case FaultKind::kCovered:
      image = cv::Mat(before.size(), before.type(), cv::Scalar());
      break;
    case FaultKind::kWhite:
      image = cv::Mat(before.size(), before.type(), cv::Scalar::all(255));
      break;
    case FaultKind::kNoise:
      image = noise_like(before, 0, 256, random_());
      break;
    case FaultKind::kHalfBlack:
      image = before.clone();
      image.rowRange(image.rows / 2, image.rows).setTo(cv::Scalar());
      break;
    case FaultKind::kDim:
      image = cv::Mat();
      before.convertTo(image, -1, 0.2);
      break;
    case FaultKind::kBlurred:
      image = cv::Mat();
      cv::blur(before, image, {25, 3});
      break;
    case FaultKind::kTruncated:
      image = before.rowRange(0, before.rows / 2).clone();
      frame.refused = true;
      break;
    case FaultKind::kOtherSize:
      image = cv::Mat();
      cv::resize(before, image, {}, 2.0, 2.0);
      frame.refused = true;
      break;
    default:
      break;
  }
}

void FaultySource::spoil_depth(FaultyFrame& frame, FaultKind kind, std::size_t index) {
  cv::Mat& depth = frame.input.depth;
  const cv::Mat before = depth;
  switch (kind) {
    case FaultKind::kNoise:
      depth = noise_like(before, 0.3, 8.0, random_());
      break;
    case FaultKind::kNoDepth:
      depth.release();
      break;
    case FaultKind::kNanDepth:
      depth = cv::Mat(before.size(), CV_32FC1, std::numeric_limits<float>::quiet_NaN());
      break;
    case FaultKind::kZeroDepth:
    case FaultKind::kCovered:
      depth = cv::Mat(before.size(), CV_32FC1, cv::Scalar());
      break;
    case FaultKind::kWildDepth: {
      depth = before.clone();
      const float wild[] = {std::numeric_limits<float>::infinity(), -1.0F, 1e30F, 1e-30F, -0.0F};
      for (float& z : cv::Mat_<float>(depth)) {
        if (random_() % 4 == 0) z = wild[random_() % std::size(wild)];
      }
      break;
    }
    case FaultKind::kSparseDepth:
      depth = before.clone();
      for (float& z : cv::Mat_<float>(depth)) {
        if (random_() % 50 != 0) z = 0.0F;
      }
      break;
    case FaultKind::kLateDepth:
      depth = frames_[index - std::min(index, kLateBy)].depth;
      break;
    case FaultKind::kWrongUnits:
      depth = cv::Mat();
      before.convertTo(depth, -1, 0.5);
      break;
    case FaultKind::kOtherType:
      depth = cv::Mat(before.size(), CV_16UC1, cv::Scalar(1000));
      frame.refused = true;
      break;
    default:
      break;
  }
}

void FaultySource::spoil_mask(FaultyFrame& frame, FaultKind kind, std::size_t index) {
  cv::Mat& mask = frame.input.mask;
  switch (kind) {
    case FaultKind::kSegmenterDies:
      mask.release();
      break;
    case FaultKind::kAllMasked:
      mask = cv::Mat(mask.size(), CV_8UC1, cv::Scalar(255));
      break;
    case FaultKind::kNoiseMask:
      mask = noise_like(mask, 0, 2, random_()) * 255;
      break;
    case FaultKind::kInvertedMask:
      mask = mask == 0;
      break;
    case FaultKind::kLateMask:
      mask = clean_input(frames_[index - std::min(index, kLateBy)]).mask;
      break;
    case FaultKind::kWrongMask:
      mask = cv::Mat(mask.rows / 4, mask.cols / 4, CV_8UC1, cv::Scalar());
      frame.refused = true;
      break;
    default:
      break;
  }
}

void FaultySource::spoil(FaultyFrame& frame, const Fault& fault, std::size_t index) {
  if (fault.kind == FaultKind::kFrozen) {
    frame.shown = fault.first;
    frame.input = clean_input(frames_[fault.first]);
  } else {
    spoil_image(frame, fault.kind);
    spoil_depth(frame, fault.kind, index);
    spoil_mask(frame, fault.kind, index);
  }
  frame.input.timestamp = frames_[index].timestamp;
  if (fault.kind == FaultKind::kNanTime) {
    frame.input.timestamp = std::numeric_limits<double>::quiet_NaN();
    frame.refused = true;
  }
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
