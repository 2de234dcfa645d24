#include "dynslam/segmentation/async_segmenter.hpp"

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>
#include <utility>

#ifdef __linux__
#include <sys/resource.h>
#endif

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"

namespace dynslam::segmentation {

void AsyncOptions::validate() const {
  require(queue_capacity >= 1, "AsyncOptions", "queue_capacity", queue_capacity, "at least 1");
  require(result_capacity >= 1, "AsyncOptions", "result_capacity", result_capacity, "at least 1");
  require(niceness >= 0 && niceness <= 19, "AsyncOptions", "niceness", niceness, "0 to 19");
  require(patience >= std::chrono::milliseconds(0) && patience <= std::chrono::hours(24),
          "AsyncOptions", "patience", patience.count(), "0 milliseconds to 1 day");
}

namespace {

// A frame that owns its pixels, or shares them.
struct Job {
  cv::Mat image;
  cv::Mat depth;  // CV_32FC1, empty if the frame has none
  FrameInfo frame;
};

// Copies into old memory, unless that is somebody else's too: a segmenter's, a caller's who shared.
void copy_into(const cv::Mat& source, cv::Mat& target) {
  const bool own = target.u != nullptr && target.u->refcount == 1;
  if (!own) target.release();
  source.copyTo(target);
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
  bool enqueue(Job job);
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

// False after `stop`.
bool AsyncSegmenter::Impl::enqueue(Job job) {
  job.frame.depth = as_view<const float>(job.depth);
  std::deque<Job> dropped;  // freed outside the lock
  {
    const std::lock_guard<std::mutex> lock(mutex);
    if (status.stopped) return false;
    ++status.submitted;
    queue.push_back(std::move(job));
    while (queue.size() > static_cast<std::size_t>(options.queue_capacity)) {
      dropped.push_back(std::move(queue.front()));
      queue.pop_front();
      ++status.replaced;
    }
    if (!dropped.empty() && !spare) {
      spare = std::move(dropped.back());
      dropped.pop_back();
    }
  }
  work.notify_one();
  return true;
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
  copy_into(image, job.image);
  copy_into(as_mat(frame.depth), job.depth);
  job.frame = frame;
  return impl_->enqueue(std::move(job));
}

bool AsyncSegmenter::submit_shared(const cv::Mat& image, const cv::Mat& depth, FrameInfo frame) {
  constexpr const char* kName = "AsyncSegmenter::submit_shared";
  require_depth_image(kName, depth);
  frame.depth = as_view<const float>(depth);
  require_segmentable(kName, image, frame);
  return impl_->enqueue({image, depth, std::move(frame)});
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
