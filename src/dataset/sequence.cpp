#include "dynslam/dataset/sequence.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dynslam/core/errors.hpp"

namespace dynslam::dataset {
namespace {

class Slice final : public Sequence {
 public:
  Slice(std::unique_ptr<Sequence> whole, std::size_t first, std::size_t last)
      : whole_(std::move(whole)), first_(first), size_(last - first) {}

  std::string name() const override { return whole_->name(); }
  std::size_t size() const override { return size_; }
  double timestamp(std::size_t index) const override {
    return whole_->timestamp(whole_index("timestamp", index));
  }
  std::string frame_name(std::size_t index) const override {
    return whole_->frame_name(whole_index("frame_name", index));
  }
  Frame read(std::size_t index) const override {
    Frame frame = whole_->read(whole_index("read", index));
    frame.index = index;
    return frame;
  }
  DepthCamera camera() const override { return whole_->camera(); }
  SensorKind sensor() const override { return whole_->sensor(); }
  double fps() const override { return whole_->fps(); }
  const Trajectory& truth() const override { return whole_->truth(); }
  OpenReport report() const override { return whole_->report(); }

 private:
  std::size_t whole_index(const char* function, std::size_t index) const {
    if (index >= size_) {
      throw_invalid_argument(std::string("Sequence::") + function, "index", index,
                             "less than " + std::to_string(size_));
    }
    return first_ + index;
  }

  std::unique_ptr<Sequence> whole_;
  std::size_t first_;
  std::size_t size_;
};

}  // namespace

const char* to_string(SensorKind sensor) {
  switch (sensor) {
    case SensorKind::kMono:
      return "mono";
    case SensorKind::kRgbd:
      return "rgbd";
    case SensorKind::kStereo:
      return "stereo";
  }
  return "unknown";
}

Sequence::~Sequence() = default;

OpenReport Sequence::report() const { return {}; }

std::optional<RigidTransform> pose_at(const Trajectory& truth, double t, double max_gap) {
  constexpr double kSameTime = 1e-6;  // what the files' digits tell apart
  const auto after =
      std::lower_bound(truth.begin(), truth.end(), t - kSameTime,
                       [](const StampedPose& pose, double time) { return pose.timestamp < time; });
  if (after == truth.end() || std::isnan(t)) return std::nullopt;
  if (after->timestamp <= t + kSameTime) return after->T_world_cam;
  if (after == truth.begin()) return std::nullopt;
  const auto before = std::prev(after);
  const double gap = after->timestamp - before->timestamp;
  if (!(gap <= max_gap)) return std::nullopt;
  return interpolate(before->T_world_cam, after->T_world_cam, (t - before->timestamp) / gap);
}

std::unique_ptr<Sequence> slice(std::unique_ptr<Sequence> sequence, std::size_t first,
                                std::size_t last) {
  require(sequence != nullptr, "slice", "sequence", "null", "a sequence");
  last = std::min(last, sequence->size());
  require(first < last, "slice", "first", first, "less than " + std::to_string(last));
  return std::make_unique<Slice>(std::move(sequence), first, last);
}

}  // namespace dynslam::dataset
