// What the system sees: features by verdict, the mask and its age, the way so far.
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/dataset/sequence.hpp"
#include "dynslam/slam/system.hpp"

#include "run_session.hpp"

namespace dynslam::cli {

/// Draws each frame into a film, a window, or both; does nothing when neither is asked for.
class LiveView {
 public:
  /// Opens what `flags.video` and `flags.show` name. Throws IoError when the file cannot be written
  /// (in the format of its ending: .mp4 or .avi) or there is no display.
  LiveView(const RunFlags& flags, const dataset::Sequence& sequence);
  ~LiveView();
  LiveView(const LiveView&) = delete;
  LiveView& operator=(const LiveView&) = delete;

  /// Draws a frame that has been tracked. `mask`: as the system got it.
  void add(const dataset::Frame& frame, const cv::Mat& mask, const FrameRow& row,
           const slam::FrameResult& result, const slam::System& system);

  /// Ends the film. Throws IoError when nothing has arrived in the file.
  void finish();

 private:
  class Film;
  class Window;

  bool active() const { return film_ != nullptr || window_ != nullptr; }

  std::string name_;  ///< of the system
  std::unique_ptr<Film> film_;
  std::unique_ptr<Window> window_;
  std::vector<cv::Point2d> way_;  ///< x and z of the camera, metres
};

/// Colours the features of an image by what became of them, in place; `image` is BGR.
void draw_features(cv::Mat& image, const slam::FeaturesView& view);

}  // namespace dynslam::cli
