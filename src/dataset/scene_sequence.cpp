// The rendered scene as a Sequence.
#include <string>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/scene.hpp"

namespace dynslam::dataset {

namespace {

class SceneSequence final : public Sequence {
 public:
  SceneSequence(std::string name, const SceneOptions& options)
      : name_(std::move(name)), scene_(options) {
    truth_.reserve(options.frames);
    for (std::size_t i = 0; i < options.frames; ++i) {
      truth_.push_back({scene_.timestamp(i), scene_.T_world_cam(i)});
    }
  }

  std::string name() const override { return name_; }
  std::size_t size() const override { return scene_.options().frames; }
  double timestamp(std::size_t index) const override {
    check("timestamp", index);
    return scene_.timestamp(index);
  }
  std::string frame_name(std::size_t index) const override {
    check("frame_name", index);
    return scene_.frame_name(index);
  }
  Frame read(std::size_t index) const override {
    check("read", index);
    return scene_.render(index);
  }
  DepthCamera camera() const override { return scene_.camera(); }
  SensorKind sensor() const override {
    return scene_.options().stereo_baseline > 0.0 ? SensorKind::kStereo : SensorKind::kRgbd;
  }
  double fps() const override { return scene_.options().fps; }
  const Trajectory& truth() const override { return truth_; }

 private:
  void check(const char* function, std::size_t index) const {
    require(index < size(), std::string("Sequence::") + function, "index", index,
            "less than the " + std::to_string(size()) + " frames of " + name_);
  }

  std::string name_;
  RenderedScene scene_;
  Trajectory truth_;
};

}  // namespace

std::vector<std::string> scene_names() { return {"room_walking", "room_still"}; }

std::unique_ptr<Sequence> make_scene(std::string_view name, const SceneOptions& options) {
  if (name != "room_walking" && name != "room_still") {
    throw_invalid_argument("make_scene", "name", name, "room_walking or room_still");
  }
  SceneOptions chosen = options;
  if (name == "room_still") chosen.movers = false;
  return std::make_unique<SceneSequence>(std::string(name), chosen);
}

}  // namespace dynslam::dataset
