#include "dynslam/segmentation/async_segmenter.hpp"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <functional>
#include <future>
#include <limits>
#include <memory>
#include <mutex>
#include <random>
#include <stdexcept>
#include <thread>

#include <gtest/gtest.h>
#ifdef __linux__
#include <sys/resource.h>
#endif

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/simple_segmenters.hpp"

namespace dynslam::segmentation {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

// A door that a segmenter waits at until the test opens it.
class Gate {
 public:
  void open() {
    const std::lock_guard<std::mutex> lock(mutex_);
    open_ = true;
    changed_.notify_all();
  }
  void pass() {
    std::unique_lock<std::mutex> lock(mutex_);
    ++arrived_;
    changed_.notify_all();
    changed_.wait(lock, [this] { return open_; });
  }
  void wait_for_arrival() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return arrived_ > 0; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool open_ = false;
  int arrived_ = 0;
};

// Does what it is told; one instance whose label is the grey value of the first pixel.
class ScriptedSegmenter final : public Segmenter {
 public:
  using Script = std::function<void(const FrameInfo&)>;
  using Spoil = std::function<void(const FrameInfo&, Segmentation&)>;

  explicit ScriptedSegmenter(Script script, Spoil spoil = {})
      : script_(std::move(script)), spoil_(std::move(spoil)) {}

  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override {
    if (script_) script_(frame);
    Segmentation result;
    result.width = image.cols;
    result.height = image.rows;
    Instance instance;
    instance.label = image.at<std::uint8_t>(0, 0);
    instance.score = frame.depth.empty() ? 0.0F : frame.depth(1, 1);
    instance.box = cv::Rect(0, 0, 1, 1);
    instance.mask = cv::Mat(1, 1, CV_8UC1, cv::Scalar(255));
    result.instances.push_back(instance);
    if (spoil_) spoil_(frame, result);
    return result;
  }
  const std::vector<std::string>& class_names() const override { return names_; }
  SegmenterInfo info() const override {
    SegmenterInfo info;
    info.kind = "scripted";
    return info;
  }

 private:
  Script script_;
  Spoil spoil_;
  std::vector<std::string> names_{"thing"};
};

std::unique_ptr<Segmenter> scripted(std::function<void(const FrameInfo&)> script = {}) {
  return std::make_unique<ScriptedSegmenter>(std::move(script));
}

FrameInfo frame_of(std::uint64_t index) {
  FrameInfo frame;
  frame.index = index;
  frame.timestamp = 0.1 * static_cast<double>(index);
  frame.name = std::to_string(index);
  return frame;
}

cv::Mat image_of(int value) { return cv::Mat(6, 8, CV_8UC1, cv::Scalar(value)); }

TEST(AsyncSegmenter, GivesEveryResultWithItsFrame) {
  AsyncSegmenter async(scripted());
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(async.submit(image_of(i), frame_of(static_cast<std::uint64_t>(i))));
    const auto result = async.wait(seconds(20));
    ASSERT_TRUE(result.has_value());
    EXPECT_EQ(result->index, static_cast<std::uint64_t>(i));
    EXPECT_EQ(result->name, std::to_string(i));
    EXPECT_DOUBLE_EQ(result->timestamp, 0.1 * i);
    EXPECT_EQ(result->segmentation.instances.at(0).label, i);
  }
  EXPECT_FALSE(async.take().has_value());
  EXPECT_EQ(async.status().finished, 20U);
  EXPECT_EQ(async.class_names(), std::vector<std::string>{"thing"});
  EXPECT_EQ(async.info().kind, "scripted");
}

TEST(AsyncSegmenter, LetsTheNewestFrameWin) {
  Gate gate;
  AsyncSegmenter async(scripted([&](const FrameInfo&) { gate.pass(); }));
  async.submit(image_of(0), frame_of(0));
  gate.wait_for_arrival();
  for (int i = 1; i <= 9; ++i) async.submit(image_of(i), frame_of(static_cast<std::uint64_t>(i)));
  AsyncStatus status = async.status();
  EXPECT_TRUE(status.busy);
  EXPECT_EQ(status.waiting, 1U);
  EXPECT_EQ(status.replaced, 8U);
  gate.open();
  ASSERT_TRUE(async.wait_idle(seconds(20)));
  EXPECT_EQ(async.take()->index, 0U);
  EXPECT_EQ(async.take()->index, 9U);
  EXPECT_FALSE(async.take().has_value());
  status = async.status();
  EXPECT_EQ(status.submitted, status.finished + status.failed + status.replaced);
}

TEST(AsyncSegmenter, OwnsWhatItIsGiven) {
  Gate gate;
  AsyncSegmenter async(scripted([&](const FrameInfo&) { gate.pass(); }));
  {
    cv::Mat image = image_of(7);
    std::vector<float> depth(48, 2.5F);
    FrameInfo frame = frame_of(1);
    frame.depth = DepthView(depth.data(), 8, 6);
    async.submit(image, frame);
    gate.wait_for_arrival();
    image.setTo(0);
    std::fill(depth.begin(), depth.end(), 0.0F);
  }
  gate.open();
  const auto result = async.wait(seconds(20));
  ASSERT_TRUE(result.has_value());
  EXPECT_EQ(result->segmentation.instances[0].label, 7);
  EXPECT_EQ(result->segmentation.instances[0].score, 2.5F);
}

TEST(AsyncSegmenter, KeepsWhatItSharesAliveAndNeverWritesToIt) {
  std::vector<std::uint8_t> pixels(48, 7);
  AsyncSegmenter async(scripted());
  {
    const cv::Mat depth(6, 8, CV_32FC1, cv::Scalar(2.5));
    async.submit_shared(cv::Mat(6, 8, CV_8UC1, pixels.data()), depth, frame_of(1));
  }
  const auto shared = async.wait(seconds(20));
  ASSERT_TRUE(shared.has_value());
  EXPECT_EQ(shared->segmentation.instances[0].label, 7);
  EXPECT_EQ(shared->segmentation.instances[0].score, 2.5F);
  ASSERT_TRUE(async.wait_idle(seconds(20)));
  for (std::uint64_t i = 2; i < 5; ++i) {
    async.submit(image_of(3), frame_of(i));
    ASSERT_TRUE(async.wait_idle(seconds(20)));
  }
  EXPECT_EQ(pixels, std::vector<std::uint8_t>(48, 7));
}

TEST(AsyncSegmenter, GoesOnAfterAnExceptionAndTellsOfIt) {
  AsyncSegmenter async(scripted([](const FrameInfo& frame) {
    if (frame.index == 100) throw std::runtime_error("the network broke");
    if (frame.index == 101) throw 42;
  }));
  for (std::uint64_t i = 99; i <= 102; ++i) {
    async.submit(image_of(1), frame_of(i));
    ASSERT_TRUE(async.wait_idle(seconds(20)));
    if (i == 100) {
      EXPECT_EQ(async.status().last_error, "the network broke");
      EXPECT_EQ(async.status().last_failed_index, 100U);
    }
  }
  EXPECT_EQ(async.status().failed, 2U);
  EXPECT_EQ(async.status().last_failed_index, 101U);
  EXPECT_NE(async.status().last_error.find("not a std::exception"), std::string::npos);
  EXPECT_EQ(async.take()->index, 99U);
  EXPECT_EQ(async.take()->index, 102U);
}

TEST(AsyncSegmenter, CountsMasksThatAreNoMasksAsFailures) {
  const std::vector<std::function<void(Segmentation&)>> spoils = {
      [](Segmentation& s) { s.width = 7; },
      [](Segmentation& s) { s.height = 0; },
      [](Segmentation& s) { s.instances[0].mask = cv::Mat(); },
      [](Segmentation& s) { s.instances[0].mask = cv::Mat(2, 1, CV_8UC1, cv::Scalar(255)); },
      [](Segmentation& s) { s.instances[0].mask = cv::Mat(1, 1, CV_32FC1, cv::Scalar(1)); },
      [](Segmentation& s) { s.instances[0].box = cv::Rect(); },
      [](Segmentation& s) { s.instances[0].box.x = -1; },
      [](Segmentation& s) { s.instances[0].box.y = 6; },
      [](Segmentation& s) { s.instances[0].box.width = std::numeric_limits<int>::max(); },
      [](Segmentation& s) { s.instances[0].box.x = std::numeric_limits<int>::min(); },
  };
  const auto spoil = [&](const FrameInfo& frame, Segmentation& found) {
    if (frame.index < spoils.size()) spoils[frame.index](found);
  };
  AsyncSegmenter async(std::make_unique<ScriptedSegmenter>(ScriptedSegmenter::Script(), spoil));
  for (std::uint64_t i = 0; i <= spoils.size(); ++i) {
    async.submit(image_of(1), frame_of(i));
    ASSERT_TRUE(async.wait_idle(seconds(20)));
    EXPECT_EQ(async.status().failed, std::min<std::uint64_t>(i + 1, spoils.size()));
  }
  EXPECT_NE(async.status().last_error.find("a box inside the image"), std::string::npos);
  EXPECT_EQ(async.take()->index, spoils.size());
  EXPECT_FALSE(async.take().has_value());
}

TEST(AsyncSegmenter, LeavesBehindASegmenterThatHangs) {
  const auto gate = std::make_shared<Gate>();
  const auto gone = std::make_shared<std::promise<void>>();
  std::shared_ptr<void> life(nullptr, [gone](void*) { gone->set_value(); });
  AsyncOptions options;
  options.patience = milliseconds(20);
  {
    AsyncSegmenter async(
        scripted([gate, life = std::move(life)](const FrameInfo&) { gate->pass(); }), options);
    async.submit(image_of(0), frame_of(7));
    gate->wait_for_arrival();
    async.submit(image_of(0), frame_of(8));
    EXPECT_FALSE(async.finish());
    const AsyncStatus status = async.status();
    EXPECT_TRUE(status.overdue);
    EXPECT_EQ(status.busy_index, 7U);
    EXPECT_EQ(status.waiting, 0U);
  }
  gate->open();
  EXPECT_EQ(gone->get_future().wait_for(seconds(20)), std::future_status::ready);
}

TEST(AsyncSegmenter, FinishesTheFrameInWork) {
  AsyncSegmenter async(
      scripted([](const FrameInfo&) { std::this_thread::sleep_for(milliseconds(20)); }));
  async.submit(image_of(3), frame_of(3));
  while (!async.status().busy && async.status().finished == 0) std::this_thread::yield();
  EXPECT_TRUE(async.finish());
  EXPECT_FALSE(async.status().overdue);
  EXPECT_EQ(async.take()->index, 3U);
}

TEST(AsyncSegmenter, KeepsOnlySoManyResults) {
  AsyncOptions options;
  options.result_capacity = 2;
  AsyncSegmenter async(scripted(), options);
  for (std::uint64_t i = 0; i < 5; ++i) {
    async.submit(image_of(1), frame_of(i));
    ASSERT_TRUE(async.wait_idle(seconds(20)));
  }
  EXPECT_EQ(async.take()->index, 3U);
  EXPECT_EQ(async.take()->index, 4U);
}

TEST(AsyncSegmenter, DoesNotWaitForNothing) {
  AsyncSegmenter async(scripted());
  EXPECT_FALSE(async.wait(seconds(600)).has_value());
  EXPECT_TRUE(async.wait_idle(seconds(600)));
  Gate gate;
  AsyncSegmenter busy(scripted([&](const FrameInfo&) { gate.pass(); }));
  busy.submit(image_of(1), frame_of(1));
  EXPECT_FALSE(busy.wait(milliseconds(1)).has_value());
  EXPECT_FALSE(busy.wait_idle(milliseconds(1)));
  gate.open();
}

TEST(AsyncSegmenter, AcceptsNothingAfterStop) {
  AsyncSegmenter async(scripted());
  async.submit(image_of(3), frame_of(3));
  ASSERT_TRUE(async.wait_idle(seconds(20)));
  async.stop();
  async.stop();
  EXPECT_FALSE(async.submit(image_of(4), frame_of(4)));
  EXPECT_TRUE(async.status().stopped);
  EXPECT_EQ(async.take()->index, 3U) << "what was finished stays";
  EXPECT_EQ(async.status().submitted, 1U);
}

TEST(AsyncSegmenter, RefusesWhatIsNotAnImageInTheCallersThread) {
  AsyncSegmenter async(scripted());
  EXPECT_THROW(async.submit(cv::Mat(), frame_of(0)), InvalidArgument);
  EXPECT_THROW(async.submit(cv::Mat(4, 4, CV_32F), frame_of(0)), InvalidArgument);
  EXPECT_THROW(async.submit_shared(cv::Mat(), cv::Mat(), frame_of(0)), InvalidArgument);
  const cv::Mat millimetres(6, 8, CV_16UC1, cv::Scalar(1));
  EXPECT_THROW(async.submit_shared(image_of(0), millimetres, frame_of(0)), InvalidArgument);
  const cv::Mat small(3, 4, CV_32FC1, cv::Scalar(1));
  EXPECT_THROW(async.submit_shared(image_of(0), small, frame_of(0)), InvalidArgument);
  EXPECT_THROW(AsyncSegmenter(nullptr), InvalidArgument);
  EXPECT_EQ(async.status().submitted, 0U);
}

TEST(AsyncOptions, AreCheckedByName) {
  AsyncOptions options;
  options.queue_capacity = 0;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = {};
  options.result_capacity = 0;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = {};
  options.niceness = 20;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = {};
  options.patience = milliseconds(-1);
  EXPECT_THROW(options.validate(), InvalidArgument);
}

#ifdef __linux__
TEST(AsyncSegmenter, GivesWayToItsCaller) {
  const int here = getpriority(PRIO_PROCESS, 0);
  std::atomic<int> there{-100};
  AsyncOptions options;
  options.niceness = 3;
  AsyncSegmenter async(scripted([&](const FrameInfo&) { there = getpriority(PRIO_PROCESS, 0); }),
                       options);
  async.submit(image_of(1), frame_of(1));
  ASSERT_TRUE(async.wait_idle(seconds(20)));
  EXPECT_EQ(there.load(), std::min(here + 3, 19));
  EXPECT_EQ(getpriority(PRIO_PROCESS, 0), here);
}
#endif

TEST(AsyncSegmenter, StartsAndStopsAThousandTimesInRandomStates) {
  std::mt19937 random(17);
  for (int round = 0; round < 1000; ++round) {
    const int submitted = static_cast<int>(random() % 4);
    const bool throws = random() % 8 == 0;
    const bool slow = random() % 4 == 0;
    AsyncSegmenter async(scripted([=](const FrameInfo&) {
      if (slow) std::this_thread::yield();
      if (throws) throw std::runtime_error("now");
    }));
    for (int i = 0; i < submitted; ++i) {
      async.submit(image_of(i), frame_of(static_cast<std::uint64_t>(i)));
    }
    switch (random() % 5) {
      case 0:
        async.take();
        break;
      case 1:
        async.wait(milliseconds(50));
        break;
      case 2:
        async.stop();
        break;
      case 3:
        async.wait_idle(seconds(20));
        break;
      default:
        break;
    }
  }
}

TEST(AsyncSegmenter, ServesSeveralThreadsAtOnce) {
  std::atomic<int> taken{0};
  AsyncSegmenter async(scripted());
  std::vector<std::thread> threads;
  for (int t = 0; t < 3; ++t) {
    threads.emplace_back([&, t] {
      for (std::uint64_t i = 0; i < 200; ++i) {
        async.submit(image_of(t), frame_of(i));
        if (async.take().has_value()) ++taken;
        async.status();
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  ASSERT_TRUE(async.wait_idle(seconds(20)));
  const AsyncStatus status = async.status();
  EXPECT_EQ(status.submitted, 600U);
  EXPECT_EQ(status.submitted, status.finished + status.replaced);
  while (async.take().has_value()) ++taken;
  EXPECT_GT(taken.load(), 0);
}

}  // namespace
}  // namespace dynslam::segmentation
