#include "dynslam/segmentation/async_segmenter.hpp"

#include <algorithm>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <mutex>
#include <thread>
#include <utility>

#ifdef __linux__
#include <sys/resource.h>
#endif

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {

void AsyncOptions::validate() const {
  require(queue_capacity >= 1, "AsyncOptions", "queue_capacity", queue_capacity, "at least 1");
  require(result_capacity >= 1, "AsyncOptions", "result_capacity", result_capacity, "at least 1");
  require(niceness >= 0 && niceness <= 19, "AsyncOptions", "niceness", niceness, "0 to 19");
  require(patience >= std::chrono::milliseconds(0) && patience <= std::chrono::hours(24),
          "AsyncOptions", "patience", patience.count(), "0 milliseconds to 1 day");
}

namespace {

// A frame that owns its pixels.
struct Job {
  cv::Mat image;
  std::vector<float> depth;
  FrameInfo frame;
};

// Makes `job` hold a copy of a frame; in its old memory, unless a segmenter kept the old image.
void own(const cv::Mat& image, const FrameInfo& frame, Job& job) {
  const bool kept = job.image.u != nullptr && job.image.u->refcount > 1;
  if (kept) job.image.release();
  image.copyTo(job.image);
  job.frame = frame;
  job.frame.depth = {};
  job.depth.resize(static_cast<std::size_t>(frame.depth.width) *
                   static_cast<std::size_t>(frame.depth.height));
  for (int y = 0; y < frame.depth.height; ++y) {
    const auto width = static_cast<std::size_t>(frame.depth.width);
    std::memcpy(job.depth.data() + static_cast<std::size_t>(y) * width, frame.depth.row(y),
                width * sizeof(float));
  }
}

// On Linux the niceness belongs to the thread that calls. If it is refused, all stays as it was.
void give_way(int niceness) {
#ifdef __linux__
  if (niceness > 0) setpriority(PRIO_PROCESS, 0, getpriority(PRIO_PROCESS, 0) + niceness);
#else
  static_cast<void>(niceness);
#endif
}

}  // namespace

struct AsyncSegmenter::Impl {
  // Constant after construction.
  std::unique_ptr<Segmenter> segmenter;
  AsyncOptions options;
  std::vector<std::string> names;
  SegmenterInfo info;

  // Guarded by `mutex`.
  mutable std::mutex mutex;
  std::condition_variable work;     // a frame came, or stop
  std::condition_variable changed;  // a frame was finished, failed or dropped
  std::deque<Job> queue;
  std::optional<Job> spare;  // memory of a frame that is done with
  std::deque<AsyncResult> results;
  AsyncStatus status;
  std::chrono::steady_clock::time_point overdue_at;  // the frame in work

  std::thread worker;

  bool idle() const { return queue.empty() && !status.busy; }
  void run();
  void process(Job& job, std::unique_lock<std::mutex>& lock);
};

void AsyncSegmenter::Impl::run() {
  give_way(options.niceness);
  std::unique_lock<std::mutex> lock(mutex);
  while (true) {
    work.wait(lock, [this] { return status.stopped || !queue.empty(); });
    if (status.stopped) return;
    Job job = std::move(queue.front());
    queue.pop_front();
    status.busy = true;
    status.busy_index = job.frame.index;
    overdue_at = std::chrono::steady_clock::now() + options.patience;
    process(job, lock);
    spare = std::move(job);
    status.busy = false;
    changed.notify_all();
  }
}

// Called with the lock held, which is open while the network runs.
void AsyncSegmenter::Impl::process(Job& job, std::unique_lock<std::mutex>& lock) {
  if (!job.depth.empty()) {
    job.frame.depth = DepthView(job.depth.data(), job.image.cols, job.image.rows);
  }
  AsyncResult result{job.frame.index, job.frame.timestamp, job.frame.name, {}};
  std::string error;
  bool failed = false;
  lock.unlock();
  try {
    result.segmentation = segmenter->segment(job.image, job.frame);
    require_sound("Segmenter::segment", result.segmentation, job.image.size());
  } catch (const std::exception& exception) {
    failed = true;
    error = exception.what();
  } catch (...) {
    failed = true;
    error = "an exception that is not a std::exception";
  }
  lock.lock();
  if (failed) {
    ++status.failed;
    status.last_error = std::move(error);
    status.last_failed_index = result.index;
    return;
  }
  ++status.finished;
  if (results.size() >= static_cast<std::size_t>(options.result_capacity)) results.pop_front();
  results.push_back(std::move(result));
}

AsyncSegmenter::AsyncSegmenter(std::unique_ptr<Segmenter> segmenter, const AsyncOptions& options)
    : impl_(std::make_shared<Impl>()) {
  options.validate();
  require(segmenter != nullptr, "AsyncSegmenter", "segmenter", "null", "a segmenter");
  impl_->segmenter = std::move(segmenter);
  impl_->options = options;
  impl_->names = impl_->segmenter->class_names();
  impl_->info = impl_->segmenter->info();
  impl_->worker = std::thread([impl = impl_] { impl->run(); });
}

AsyncSegmenter::~AsyncSegmenter() {
  if (finish()) {
    impl_->worker.join();
  } else {
    impl_->worker.detach();
  }
}

bool AsyncSegmenter::submit(const cv::Mat& image, const FrameInfo& frame) {
  require_segmentable("AsyncSegmenter::submit", image, frame);
  Job job;
  {
    const std::lock_guard<std::mutex> lock(impl_->mutex);
    if (impl_->status.stopped) return false;
    if (impl_->spare) job = std::move(*impl_->spare);
    impl_->spare.reset();
  }
  own(image, frame, job);
  std::deque<Job> dropped;  // freed outside the lock
  {
    const std::lock_guard<std::mutex> lock(impl_->mutex);
    if (impl_->status.stopped) return false;
    ++impl_->status.submitted;
    impl_->queue.push_back(std::move(job));
    while (impl_->queue.size() > static_cast<std::size_t>(impl_->options.queue_capacity)) {
      dropped.push_back(std::move(impl_->queue.front()));
      impl_->queue.pop_front();
      ++impl_->status.replaced;
    }
    if (!dropped.empty() && !impl_->spare) {
      impl_->spare = std::move(dropped.back());
      dropped.pop_back();
    }
  }
  impl_->work.notify_one();
  return true;
}

std::optional<AsyncResult> AsyncSegmenter::take() {
  const std::lock_guard<std::mutex> lock(impl_->mutex);
  if (impl_->results.empty()) return std::nullopt;
  AsyncResult result = std::move(impl_->results.front());
  impl_->results.pop_front();
  return result;
}

std::optional<AsyncResult> AsyncSegmenter::wait(std::chrono::milliseconds timeout) {
  std::unique_lock<std::mutex> lock(impl_->mutex);
  impl_->changed.wait_for(lock, timeout,
                          [this] { return !impl_->results.empty() || impl_->idle(); });
  if (impl_->results.empty()) return std::nullopt;
  AsyncResult result = std::move(impl_->results.front());
  impl_->results.pop_front();
  return result;
}

bool AsyncSegmenter::wait_idle(std::chrono::milliseconds timeout) {
  std::unique_lock<std::mutex> lock(impl_->mutex);
  return impl_->changed.wait_for(lock, timeout, [this] { return impl_->idle(); });
}

void AsyncSegmenter::stop() {
  std::deque<Job> dropped;
  {
    const std::lock_guard<std::mutex> lock(impl_->mutex);
    impl_->status.stopped = true;
    impl_->status.replaced += impl_->queue.size();
    dropped.swap(impl_->queue);
  }
  impl_->work.notify_all();
  impl_->changed.notify_all();
}

bool AsyncSegmenter::finish() {
  stop();
  std::unique_lock<std::mutex> lock(impl_->mutex);
  return impl_->changed.wait_until(lock, impl_->overdue_at, [this] { return impl_->idle(); });
}

AsyncStatus AsyncSegmenter::status() const {
  const std::lock_guard<std::mutex> lock(impl_->mutex);
  AsyncStatus status = impl_->status;
  status.waiting = impl_->queue.size();
  status.overdue = status.busy && std::chrono::steady_clock::now() >= impl_->overdue_at;
  return status;
}

const std::vector<std::string>& AsyncSegmenter::class_names() const { return impl_->names; }

SegmenterInfo AsyncSegmenter::info() const { return impl_->info; }

}  // namespace dynslam::segmentation
