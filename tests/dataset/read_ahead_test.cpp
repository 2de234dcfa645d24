#include "dynslam/dataset/read_ahead.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <set>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::dataset {
namespace {

// Frames without images; reading can be made to fail, and to wait until it is let go on.
class FakeSequence : public Sequence {
 public:
  explicit FakeSequence(std::size_t size) : size_(size) {}
  std::string name() const override { return "fake"; }
  std::size_t size() const override { return size_; }
  double timestamp(std::size_t index) const override { return static_cast<double>(index); }
  std::string frame_name(std::size_t index) const override { return std::to_string(index); }
  Frame read(std::size_t index) const override {
    ++reads;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      changed_.wait(lock, [&] { return index < gate_; });
    }
    if (bad.count(index) != 0) throw IoError(std::to_string(index) + ".png: is broken");
    if (strange.count(index) != 0) throw 42;
    Frame frame;
    frame.index = index;
    return frame;
  }
  DepthCamera camera() const override { return {}; }
  SensorKind sensor() const override { return SensorKind::kMono; }
  double fps() const override { return 1.0; }
  const Trajectory& truth() const override { return truth_; }

  // Frames from `index` on wait in `read` until this is called with more.
  void open_gate(std::size_t index) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      gate_ = index;
    }
    changed_.notify_all();
  }
  void wait_for_reads(std::size_t n) const {
    while (reads < n) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }

  mutable std::atomic<std::size_t> reads{0};
  std::set<std::size_t> bad, strange;

 private:
  std::size_t size_;
  Trajectory truth_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  std::size_t gate_ = 1000000;
};

ReadAheadOptions with_capacity(std::size_t capacity) {
  ReadAheadOptions options;
  options.capacity = capacity;
  return options;
}

ReadAheadOptions with_pauses(std::size_t capacity) {
  ReadAheadOptions options = with_capacity(capacity);
  options.pause_at_work = true;
  return options;
}

TEST(ReadAhead, ReadsNothingWhileItsCallerWorksIfToldSo) {
  const FakeSequence sequence(20);
  ReadAhead ahead(sequence, with_pauses(2));
  sequence.wait_for_reads(2);
  ASSERT_TRUE(ahead.next());
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_EQ(sequence.reads, 2U);
  ahead.read_on();
  sequence.wait_for_reads(3);
  ASSERT_TRUE(ahead.next());
  EXPECT_EQ(sequence.reads, 3U);
}

TEST(ReadAhead, ThatPausesGivesEveryFrameToThoseWhoOnlyAskForTheNext) {
  const FakeSequence sequence(50);
  ReadAhead ahead(sequence, with_pauses(3));
  std::atomic<int> sum{0};
  const auto consume = [&] {
    while (const auto result = ahead.next()) sum += static_cast<int>(result->index);
  };
  std::thread other(consume);
  consume();
  other.join();
  EXPECT_EQ(sum, 49 * 50 / 2);
}

TEST(ReadAhead, GivesEveryFrameInOrderThenNothing) {
  const FakeSequence sequence(500);
  for (const std::size_t capacity : {1U, 3U, 1000U}) {
    ReadAhead ahead(sequence, with_capacity(capacity));
    for (std::size_t i = 0; i < 500; ++i) {
      const auto result = ahead.next();
      ASSERT_TRUE(result);
      EXPECT_EQ(result->index, i);
      ASSERT_TRUE(result->frame);
      EXPECT_EQ(result->frame->index, i);
      EXPECT_TRUE(result->error.empty());
    }
    EXPECT_FALSE(ahead.next());
    EXPECT_FALSE(ahead.next());
  }
}

TEST(ReadAhead, ReadsThePartThatIsAskedFor) {
  const FakeSequence sequence(10);
  ReadAheadOptions options;
  options.first = 3;
  options.last = 5;
  ReadAhead ahead(sequence, options);
  EXPECT_EQ(ahead.next()->index, 3U);
  EXPECT_EQ(ahead.next()->index, 4U);
  EXPECT_FALSE(ahead.next());
}

TEST(ReadAhead, HoldsNoMoreFramesThanItsCapacity) {
  const FakeSequence sequence(100);
  ReadAhead ahead(sequence, with_capacity(4));
  sequence.wait_for_reads(4);
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_EQ(sequence.reads, 4U);
  ahead.next();
  sequence.wait_for_reads(5);
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_EQ(sequence.reads, 5U);
}

TEST(ReadAhead, DeliversABadFrameAsAValueInItsPlace) {
  FakeSequence sequence(4);
  sequence.bad = {1};
  sequence.strange = {2};
  ReadAhead ahead(sequence);
  EXPECT_TRUE(ahead.next()->frame);
  const auto bad = ahead.next();
  EXPECT_EQ(bad->index, 1U);
  EXPECT_FALSE(bad->frame);
  EXPECT_EQ(bad->error, "1.png: is broken");
  const auto strange = ahead.next();
  EXPECT_FALSE(strange->frame);
  EXPECT_EQ(strange->error, "frame 2: unknown error");
  EXPECT_TRUE(ahead.next()->frame);
  EXPECT_FALSE(ahead.next());
}

TEST(ReadAhead, EndsAtAnyMoment) {
  const FakeSequence sequence(1000);
  for (int taken = 0; taken < 50; ++taken) {
    ReadAhead ahead(sequence, with_capacity(1 + taken % 5));
    for (int i = 0; i < taken % 7; ++i) ahead.next();
  }
  SUCCEED();  // no hang, no leak: the sanitizers watch
}

TEST(ReadAhead, StopWakesAWaitingConsumerWhileAReadIsUnderWay) {
  FakeSequence sequence(10);
  sequence.open_gate(0);
  ReadAhead ahead(sequence);
  std::optional<FrameResult> result = FrameResult();
  std::thread consumer([&] { result = ahead.next(); });
  sequence.wait_for_reads(1);
  ahead.stop();
  consumer.join();  // returns although the read has not
  EXPECT_FALSE(result);
  ahead.stop();
  EXPECT_FALSE(ahead.next());
  sequence.open_gate(10);
}

TEST(ReadAhead, SkipsWhatLiesBeforeTheFrameThatIsWanted) {
  FakeSequence sequence(100);
  sequence.open_gate(3);
  ReadAhead ahead(sequence, with_capacity(8));
  sequence.wait_for_reads(4);  // 0, 1, 2 are in the queue, 3 is under way
  ahead.skip_to(50);
  sequence.open_gate(100);
  EXPECT_EQ(ahead.next()->index, 50U);
  ahead.skip_to(10);  // backwards: no effect
  EXPECT_EQ(ahead.next()->index, 51U);
  ahead.skip_to(1000);
  EXPECT_FALSE(ahead.next());
  EXPECT_LE(sequence.reads, 4U + 2U + 8U + 1U);
}

TEST(ReadAhead, SkippingToTheEndWakesAWaitingConsumer) {
  FakeSequence sequence(5);
  sequence.open_gate(0);
  ReadAhead ahead(sequence);
  sequence.wait_for_reads(1);
  std::optional<FrameResult> result = FrameResult();
  std::thread consumer([&] { result = ahead.next(); });
  ahead.skip_to(5);
  sequence.open_gate(5);
  consumer.join();
  EXPECT_FALSE(result);
}

TEST(ReadAhead, GivesEachFrameToOneOfSeveralConsumers) {
  const FakeSequence sequence(2000);
  ReadAhead ahead(sequence, with_capacity(3));
  std::vector<std::vector<std::size_t>> taken(3);
  std::vector<std::thread> consumers;
  for (auto& mine : taken) {
    consumers.emplace_back([&] {
      while (const auto result = ahead.next()) mine.push_back(result->index);
    });
  }
  for (std::thread& consumer : consumers) consumer.join();
  std::set<std::size_t> all;
  for (const auto& mine : taken) {
    EXPECT_TRUE(std::is_sorted(mine.begin(), mine.end()));
    all.insert(mine.begin(), mine.end());
  }
  EXPECT_EQ(all.size(), 2000U);
}

TEST(ReadAheadOptions, RefuseEachValueThatBreaksItsRule) {
  const FakeSequence sequence(5);
  EXPECT_THROW(ReadAhead(sequence, with_capacity(0)), InvalidArgument);
  ReadAheadOptions options;
  options.first = 5;
  EXPECT_NO_THROW(options.validate());
  EXPECT_THROW(ReadAhead(sequence, options), InvalidArgument);
  options.first = options.last = 2;
  EXPECT_THROW(options.validate(), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::dataset
