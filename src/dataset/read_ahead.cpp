#include "dynslam/dataset/read_ahead.hpp"

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>

#include "dynslam/core/errors.hpp"

namespace dynslam::dataset {

// The queue and the place in the sequence belong to `mutex_`; frames are read without it.
class ReadAhead::Impl {
 public:
  Impl(const Sequence& sequence, std::size_t first, std::size_t last, std::size_t capacity)
      : sequence_(sequence), last_(last), capacity_(capacity), to_read_(first) {
    thread_ = std::thread([this] { run(); });
  }

  ~Impl() {
    stop();
    thread_.join();
  }

  std::optional<FrameResult> next() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return stopped_ || !queue_.empty() || at_end(); });
    if (stopped_ || queue_.empty()) return std::nullopt;
    FrameResult result = std::move(queue_.front());
    queue_.pop_front();
    lock.unlock();
    changed_.notify_all();
    return result;
  }

  void skip_to(std::size_t index) {
    std::deque<FrameResult> dropped;  // destroyed after the lock is given back
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      wanted_ = std::max(wanted_, std::min(index, last_));
      while (!queue_.empty() && queue_.front().index < wanted_) {
        dropped.push_back(std::move(queue_.front()));
        queue_.pop_front();
      }
      to_read_ = std::max(to_read_, wanted_);
    }
    changed_.notify_all();
  }

  void stop() {
    std::deque<FrameResult> dropped;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stopped_ = true;
      dropped.swap(queue_);
    }
    changed_.notify_all();
  }

 private:
  bool at_end() const { return to_read_ >= last_ && !reading_; }

  void run() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      changed_.wait(lock,
                    [this] { return stopped_ || (to_read_ < last_ && queue_.size() < capacity_); });
      if (stopped_) return;
      const std::size_t index = to_read_++;
      reading_ = true;
      lock.unlock();
      FrameResult result = read(index);
      lock.lock();
      reading_ = false;
      if (!stopped_ && index >= wanted_) queue_.push_back(std::move(result));
      changed_.notify_all();
    }
  }

  FrameResult read(std::size_t index) const {
    FrameResult result;
    result.index = index;
    try {
      result.frame = sequence_.read(index);
    } catch (const std::exception& error) {
      result.error = error.what();
    } catch (...) {
      result.error = "frame " + std::to_string(index) + ": unknown error";
    }
    return result;
  }

  const Sequence& sequence_;
  const std::size_t last_;
  const std::size_t capacity_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<FrameResult> queue_;
  std::size_t to_read_;     // the next index that is not yet taken up
  std::size_t wanted_ = 0;  // what lies before this is dropped
  bool reading_ = false;
  bool stopped_ = false;
  std::thread thread_;
};

void ReadAheadOptions::validate() const {
  require(capacity >= 1, "ReadAheadOptions", "capacity", capacity, "at least 1");
  require(first < last, "ReadAheadOptions", "first", first, "less than last");
}

ReadAhead::ReadAhead(const Sequence& sequence, const ReadAheadOptions& options) {
  options.validate();
  const std::size_t last = std::min(options.last, sequence.size());
  require(options.first < last, "ReadAhead", "first", options.first,
          "less than " + std::to_string(last));
  impl_ = std::make_unique<Impl>(sequence, options.first, last, options.capacity);
}

ReadAhead::~ReadAhead() = default;

std::optional<FrameResult> ReadAhead::next() { return impl_->next(); }
void ReadAhead::skip_to(std::size_t index) { impl_->skip_to(index); }
void ReadAhead::stop() { impl_->stop(); }

}  // namespace dynslam::dataset
