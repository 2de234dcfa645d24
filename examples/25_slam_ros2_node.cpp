// A ROS 2 node in ten minutes: synchronized colour and depth images in, a pose out.
//
// `Tracker` below is the node's whole work and knows nothing of ROS but the fields of its messages.
// Here it is fed with stand-ins of the same layout from a rendered room; docs/embedding.md shows
// the rclcpp node around it.
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

#include "support/demo.hpp"

using namespace dynslam;

// [tracker]
template <typename Image>  // sensor_msgs::msg::Image
cv::Mat wrap(const Image& message, int type) {
  return {static_cast<int>(message.height), static_cast<int>(message.width), type,
          const_cast<std::uint8_t*>(message.data.data()), message.step};
}

class Tracker {
 public:
  explicit Tracker(const DepthCamera& camera) : system_(camera, slam::p_static().options) {}

  // Pose of the camera in the world; nothing while it is lost.
  template <typename Image>
  std::optional<RigidTransform> track(const Image& color, const Image& depth) {
    slam::FrameInput frame;
    frame.timestamp = color.header.stamp.sec + 1e-9 * color.header.stamp.nanosec;
    if (color.encoding == "rgb8") {
      cv::cvtColor(wrap(color, CV_8UC3), frame.image, cv::COLOR_RGB2BGR);
    } else {
      frame.image = wrap(color, color.encoding == "mono8" ? CV_8UC1 : CV_8UC3);
    }
    if (depth.encoding == "16UC1") {
      wrap(depth, CV_16UC1).convertTo(frame.depth, CV_32F, 0.001);  // millimetres
    } else {
      frame.depth = wrap(depth, CV_32FC1);
    }
    return system_.track(frame).T_world_cam;
  }

 private:
  slam::System system_;
};
// [tracker]

namespace {

// The fields of sensor_msgs::msg::Image that are used.
struct Image {
  struct {
    struct {
      std::int32_t sec = 0;
      std::uint32_t nanosec = 0;
    } stamp;
  } header;
  std::uint32_t height = 0, width = 0, step = 0;
  std::string encoding;
  std::vector<std::uint8_t> data;
};

Image message_of(const cv::Mat& image, const std::string& encoding, double time) {
  Image message;
  message.header.stamp.sec = static_cast<std::int32_t>(time);
  message.header.stamp.nanosec = static_cast<std::uint32_t>(1e9 * (time - static_cast<int>(time)));
  message.height = static_cast<std::uint32_t>(image.rows);
  message.width = static_cast<std::uint32_t>(image.cols);
  message.step = static_cast<std::uint32_t>(image.step[0]);
  message.encoding = encoding;
  message.data.assign(image.datastart, image.dataend);
  return message;
}

}  // namespace

int main(int argc, char** argv) {
  return examples::run_demo(argc, argv, [](examples::Demo& demo) {
    Tracker tracker(demo.sequence().camera());
    std::size_t published = 0;
    Eigen::Vector3d last = Eigen::Vector3d::Zero();
    demo.for_each_frame([&](const dataset::Frame& frame) {
      cv::Mat rgb, millimetres;
      cv::cvtColor(frame.color, rgb, cv::COLOR_BGR2RGB);
      frame.depth.convertTo(millimetres, CV_16U, 1000.0);
      const auto pose = tracker.track(message_of(rgb, "rgb8", frame.timestamp),
                                      message_of(millimetres, "16UC1", frame.timestamp));
      if (!pose) return;
      ++published;
      last = pose->t;
    });
    std::printf("published %zu poses of %zu frames, the last at (%.3f, %.3f, %.3f) m\n", published,
                demo.sequence().size(), last.x(), last.y(), last.z());
    return published == demo.sequence().size() ? 0 : 1;
  });
}
