#include "slam/worker.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <future>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "slam/map_mutex.hpp"

namespace dynslam::slam {
namespace {

TEST(Worker, WorksThroughKeyframesInTheirOrder) {
  std::vector<KeyframeId> done;
  Worker worker([&](KeyframeId id) { done.push_back(id); }, 100);
  for (KeyframeId id = 0; id < 50; ++id) EXPECT_TRUE(worker.post(id));
  worker.wait_idle();
  ASSERT_EQ(done.size(), 50U);
  for (KeyframeId id = 0; id < 50; ++id) EXPECT_EQ(done[id], id);
  EXPECT_EQ(worker.failure(), nullptr);
}

TEST(Worker, RefusesMoreThanItsCapacityAndStopDropsWhatWaits) {
  std::promise<void> begun, go;
  std::atomic<int> calls{0};
  Worker worker(
      [&](KeyframeId) {
        ++calls;
        begun.set_value();
        go.get_future().wait();
      },
      2);
  EXPECT_TRUE(worker.post(1));
  begun.get_future().wait();
  EXPECT_TRUE(worker.post(2));
  EXPECT_FALSE(worker.full());
  EXPECT_TRUE(worker.post(3));
  EXPECT_TRUE(worker.full());
  EXPECT_FALSE(worker.post(4));
  EXPECT_EQ(worker.waiting(), 2U);
  std::thread stopping([&] { worker.stop(); });
  while (worker.waiting() > 0) std::this_thread::yield();
  go.set_value();
  stopping.join();
  EXPECT_EQ(calls, 1);
  EXPECT_FALSE(worker.post(5));
  worker.stop();
  worker.wait_idle();
}

TEST(Worker, KeepsWhatTheWorkThrewAndIsNotCalledAgain) {
  std::atomic<int> calls{0};
  Worker worker(
      [&](KeyframeId) {
        ++calls;
        throw std::runtime_error("full disk");
      },
      4);
  worker.post(1);
  worker.wait_idle();
  EXPECT_FALSE(worker.post(2));
  worker.wait_idle();
  EXPECT_EQ(calls, 1);
  ASSERT_NE(worker.failure(), nullptr);
  EXPECT_THROW(std::rethrow_exception(worker.failure()), std::runtime_error);
}

TEST(Worker, StopsAtAnyMoment) {
  for (int i = 0; i < 100; ++i) {
    std::atomic<int> calls{0};
    Worker worker([&](KeyframeId) { ++calls; }, 8);
    for (int k = 0; k < i % 7; ++k) worker.post(static_cast<KeyframeId>(k));
    if (i % 2 == 0) {
      worker.wait_idle();
      EXPECT_EQ(calls, i % 7);
    }
  }
}

TEST(MapMutex, LetsOneInAtATime) {
  MapMutex mutex;
  int inside = 0, most = 0, sum = 0;
  const auto enter = [&] {
    most = std::max(most, ++inside);
    ++sum;
    --inside;
  };
  std::vector<std::thread> workers;
  for (int w = 0; w < 2; ++w) {
    workers.emplace_back([&] {
      for (int i = 0; i < 2000; ++i) {
        const BackgroundLock lock(mutex);
        enter();
      }
    });
  }
  for (int i = 0; i < 2000; ++i) {
    TrackingLock lock(mutex);
    enter();
    lock.unlock();
    lock.lock();
    enter();
  }
  for (std::thread& worker : workers) worker.join();
  EXPECT_EQ(most, 1);
  EXPECT_EQ(sum, 8000);
}

TEST(MapMutex, TrackingWaitsForOnePartOfAWorkersWork) {
  MapMutex mutex;
  std::atomic<bool> over{false};
  std::atomic<int> parts{0};
  std::thread worker([&] {
    while (!over) {
      const BackgroundLock lock(mutex);
      ++parts;
      std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
  });
  while (parts == 0) std::this_thread::yield();
  std::vector<int> waited;
  for (int frame = 0; frame < 51; ++frame) {
    const int before = parts;
    TrackingLock lock(mutex);
    waited.push_back(parts - before);
  }
  over = true;
  worker.join();
  std::nth_element(waited.begin(), waited.begin() + 25, waited.end());
  EXPECT_LE(waited[25], 1);
}

}  // namespace
}  // namespace dynslam::slam
