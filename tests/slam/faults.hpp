// What goes wrong with cameras and drivers, put into a recorded sequence.
#pragma once

#include <cstddef>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "dynslam/dataset/sequence.hpp"
#include "dynslam/slam/frame.hpp"

namespace dynslam::slam::testing {

enum class FaultKind {
  kDropped,        ///< frames that never come
  kBlack,          ///< the image is black, depth goes on
  kFrozen,         ///< the driver repeats image and depth under new times
  kDoubled,        ///< a frame comes a second time under the same time: refused
  kNoise,          ///< image and depth are random
  kNoDepth,        ///< no depth image
  kNanDepth,       ///< depth all NaN
  kZeroDepth,      ///< depth all 0
  kTruncated,      ///< half an image: refused
  kSegmenterDies,  ///< no masks
  kAllMasked,      ///< everything under the mask
  kTimeGap,        ///< the clock jumps ten seconds ahead
  kTimeBackward,   ///< a frame dated before the last one: refused
  kCovered,        ///< a hand on the lens: neither image nor depth
  kKidnapped,      ///< the camera is carried elsewhere: the sequence jumps
  kHalfBlack,      ///< one half of the image is black: a torn transfer
  kWhite,          ///< the image is saturated
  kDim,            ///< the light goes down to a fifth
  kBlurred,        ///< the image is smeared over 25 pixels
  kOtherSize,      ///< image of another size: refused
  kOtherType,      ///< depth of another type: refused
  kWildDepth,      ///< depth holds infinities, negative and huge values
  kSparseDepth,    ///< one depth in fifty is left
  kLateDepth,      ///< the depth image is one of ten frames ago
  kWrongUnits,     ///< depth in other units: half of what it should be
  kNoiseMask,      ///< the mask is random
  kInvertedMask,   ///< the mask covers what stands still
  kLateMask,       ///< the mask is one of ten frames ago
  kWrongMask,      ///< mask of another size: refused
  kNanTime,        ///< no time: refused
  kCount,
};

const char* to_string(FaultKind kind);

/// One of them, from frame `first` on for `count` frames.
struct Fault {
  FaultKind kind;
  std::size_t first, count;
};

/// A frame as the system gets it.
struct FaultyFrame {
  FrameInput input;
  std::size_t shown = 0;  ///< frame of the sequence whose content this is
  bool refused = false;   ///< breaks the contract: InvalidArgument is the right answer
};

/// How much goes wrong in a run.
enum class FaultRate {
  kUsual,  ///< one to four faults
  kHarsh,  ///< five to fifteen, one hard on the other
};

/// Faults and perhaps an end before the sequence's, drawn from a seed.
class FaultySource {
 public:
  /// Frames and masks of the sequence must outlive the source. The first `quiet` frames are left
  /// in order in half of the runs, the last `quiet` always.
  FaultySource(const std::vector<dataset::Frame>& frames, std::uint64_t seed, std::size_t quiet,
               FaultRate rate = FaultRate::kUsual);

  /// All frames of the run, in order.
  std::vector<FaultyFrame> frames();
  /// Whether the run ends where the sequence does, after all faults.
  bool runs_to_the_end() const { return end_ == frames_.size(); }
  /// "black 20+7, no depth 60+3, stopped at 90".
  std::string describe() const;

 private:
  void spoil(FaultyFrame& frame, const Fault& fault, std::size_t index);
  void spoil_image(FaultyFrame& frame, FaultKind kind);
  void spoil_depth(FaultyFrame& frame, FaultKind kind, std::size_t index);
  void spoil_mask(FaultyFrame& frame, FaultKind kind, std::size_t index);
  const Fault* fault_at(std::size_t index) const;

  const std::vector<dataset::Frame>& frames_;
  std::mt19937_64 random_;
  std::vector<Fault> faults_;
  std::size_t end_;
};

/// An input of the sequence as it is, with the true mask.
FrameInput clean_input(const dataset::Frame& frame);

}  // namespace dynslam::slam::testing
