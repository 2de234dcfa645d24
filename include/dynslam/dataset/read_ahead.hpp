// Reads the next frames of a sequence while the caller works on this one.
#pragma once

#include <cstddef>
#include <limits>
#include <memory>
#include <optional>
#include <string>

#include "dynslam/dataset/sequence.hpp"

namespace dynslam::dataset {

/// A frame, or why there is none. A bad frame is a value here, so that a run may go on after it.
struct FrameResult {
  std::size_t index = 0;       ///< in the sequence
  std::optional<Frame> frame;  ///< empty if reading it failed
  std::string error;           ///< then the message of what was thrown
};

struct ReadAheadOptions {
  std::size_t capacity = 4;  ///< frames held at most, >= 1 (engineering: hides one slow read)
  std::size_t first = 0;     ///< index of the first frame, < size of the sequence
  /// End (exclusive); past the end means the end.
  std::size_t last = std::numeric_limits<std::size_t>::max();
  /// Leave the cores to the caller while it works on a frame: nothing is read from the moment a
  /// frame is handed out until `read_on`, unless `next` has to wait for it. Decoding stands in for
  /// a camera then, which takes nothing from those who use its images.
  bool pause_at_work = false;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Reads frames first, first + 1, ... of a sequence on one thread of its own (constructing it asks
/// for that thread) into a bounded queue; never reorders and never loses a frame that was not
/// skipped. Memory: at most `capacity` + 1 frames.
///
/// Thread-safety: `next`, `skip_to`, `read_on` and `stop` may be called from different threads;
/// with several consumers each frame goes to exactly one of them.
class ReadAhead {
 public:
  /// `sequence` must outlive this object. Throws InvalidArgument by `options.validate()` and if
  /// first is not smaller than last and the size of the sequence.
  explicit ReadAhead(const Sequence& sequence, const ReadAheadOptions& options = {});
  /// Stops; waits for the one read under way, if there is one.
  ~ReadAhead();
  ReadAhead(const ReadAhead&) = delete;
  ReadAhead& operator=(const ReadAhead&) = delete;

  /// The next frame in order, waiting for it if need be; nothing after the last frame or after
  /// `stop`.
  std::optional<FrameResult> next();

  /// Go on with frame `index` or a later one: what lies before it is dropped unread where possible
  /// (a camera in real time does not wait). Going back has no effect.
  void skip_to(std::size_t index);

  /// The caller has a pause: with `pause_at_work` reading goes on until the next frame is handed
  /// out. Else without effect. Returns at once.
  void read_on();

  /// Ends the reading for good; a waiting `next` returns nothing. Idempotent, does not block on a
  /// read.
  void stop();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dynslam::dataset
