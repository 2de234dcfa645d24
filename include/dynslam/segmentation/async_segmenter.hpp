// Segmentation on a thread of its own, so that tracking never waits for a network.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// What the worker finished: a segmentation and the frame it belongs to.
struct AsyncResult {
  std::uint64_t index = 0;  ///< `FrameInfo::index` of the frame
  double timestamp = 0.0;   ///< seconds, of the frame
  std::string name;         ///< of the frame
  Segmentation segmentation;
};

/// What became of the frames so far. submitted = finished + failed + replaced + waiting + busy.
struct AsyncStatus {
  std::uint64_t submitted = 0;  ///< frames that `submit` accepted
  std::uint64_t finished = 0;   ///< frames that were segmented
  /// Frames at which the segmenter threw, or gave what is not sound (`require_sound`); the worker
  /// goes on.
  std::uint64_t failed = 0;
  std::uint64_t replaced = 0;           ///< frames that gave way to a newer one before their turn
  std::uint64_t waiting = 0;            ///< frames in the queue
  bool busy = false;                    ///< a frame is being segmented right now
  std::uint64_t busy_index = 0;         ///< `FrameInfo::index` of that frame
  bool overdue = false;                 ///< and for longer than `AsyncOptions::patience`
  bool stopped = false;                 ///< `stop` was called: no frame is accepted any more
  std::string last_error;               ///< message of the latest failure, empty if there was none
  std::uint64_t last_failed_index = 0;  ///< `FrameInfo::index` of the frame it happened at
};

/// How many frames wait, and what the worker may take.
struct AsyncOptions {
  int queue_capacity = 1;   ///< frames that may wait, >= 1; a newer one pushes the oldest out
  int result_capacity = 8;  ///< results kept for `take`, >= 1; a newer one pushes the oldest out
  /// By how much the worker gives way to other threads that want its core, 0 (not at all) .. 19, as
  /// nice(1); Linux, elsewhere nothing happens. A network needs a core for most of the time between
  /// two frames, tracking for a part of it at once (engineering). Threads that the segmenter has of
  /// its own (ONNX Runtime with more than one) do not hear of it.
  int niceness = 10;
  /// How long a frame may be in work before the segmenter counts as hung, 0 ms .. 1 day
  /// (engineering: many times what the slowest network takes).
  std::chrono::milliseconds patience = std::chrono::seconds(30);

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Runs a segmenter on a worker thread; the newest frame wins.
///
/// Constructing it is what asks for the thread. Destruction is `finish`, then the end of the
/// thread. A thread whose segmenter hangs cannot be ended: it is left behind with the segmenter,
/// which goes when its call returns, if ever; so what a segmenter refers to should outlive the
/// program's interest in it. All members may be called from any thread at any time, except the
/// destructor.
class AsyncSegmenter {
 public:
  /// Takes the segmenter over. Throws InvalidArgument if it is null or an option breaks its rule.
  explicit AsyncSegmenter(std::unique_ptr<Segmenter> segmenter, const AsyncOptions& options = {});
  ~AsyncSegmenter();
  AsyncSegmenter(const AsyncSegmenter&) = delete;
  AsyncSegmenter& operator=(const AsyncSegmenter&) = delete;

  /// Copies the image and its depth and queues them; never waits for the network. False after
  /// `stop`. Throws InvalidArgument as `Segmenter::segment` does for what is not an image, in the
  /// caller's thread, so that the mistake is seen where it was made. O(pixels).
  bool submit(const cv::Mat& image, const FrameInfo& frame);

  /// The same without copies: keeps references to the image and to its depth (CV_32FC1, or empty),
  /// whose pixels must not change until the frame is done with. `frame.depth` is not looked at.
  /// Throws InvalidArgument for a depth image of another type, too. O(1).
  bool submit_shared(const cv::Mat& image, const cv::Mat& depth, FrameInfo frame);

  /// The oldest result that was not taken yet; nothing if there is none. Never waits.
  std::optional<AsyncResult> take();

  /// The same, but waits up to `timeout` for one while the worker has work; nothing when the time
  /// is over, or at once if nothing is waiting, in work or finished.
  std::optional<AsyncResult> wait(std::chrono::milliseconds timeout);

  /// Waits until nothing is waiting or in work; false if that took longer than `timeout`.
  bool wait_idle(std::chrono::milliseconds timeout);

  /// Drops the waiting frames and accepts none any more; results stay. Returns at once, any number
  /// of times.
  void stop();

  /// `stop`, then waits for the frame in work (a forward cannot be interrupted) until it is
  /// overdue. False if it is: the segmenter hangs.
  bool finish();

  AsyncStatus status() const;

  /// Of the segmenter; constant, so safe beside the worker.
  const std::vector<std::string>& class_names() const;
  SegmenterInfo info() const;

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;  // with the worker
};

}  // namespace dynslam::segmentation
