// True loops from known poses: which images show the same place, and when the camera came back.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/evaluation/loop_metrics.hpp"

namespace dynslam::evaluation {

/// An image whose pose and depth are known.
struct PlaceView {
  RigidTransform T_world_cam;
  /// Metres along the optical axis, 0 or NaN = none.
  ImageView<const float> depth;
};

/// Settings of LoopTruth. Engineering; the values are those of common sense: most of the view, and
/// next to nothing of it.
struct LoopTruthOptions {
  /// From this overlap on two images show the same place. In (0, 1].
  double same = 0.5;
  /// Below this overlap they do not. In (0, same]. In between nobody can say.
  double different = 0.1;
  /// Distance of the pixels that are looked at, in each direction. >= 1.
  int grid = 24;
  /// A point behind what the other image sees by more than this share of its distance (and 5 cm) is
  /// hidden. > 0.
  double occlusion = 0.1;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// How much of its view each image shares with each other, and what follows from it for loops.
///
/// overlap(q, r) = share of q's pixels with depth whose points r sees, or the other way round,
/// whichever is less. The `connected` images of q are the ones before it back to the last one that
/// shows another place (overlap < different): the camera has not looked elsewhere since, a SLAM
/// system has them in its map as covisible. A pair (q, r), r < q, is a true loop if r is not
/// connected to q and shows the same place.
class LoopTruth {
 public:
  /// O(n^2 pixels / grid^2). Throws InvalidArgument if the options or the camera are invalid or a
  /// depth image has another size than the camera.
  LoopTruth(Span<const PlaceView> views, const PinholeCamera& camera,
            const LoopTruthOptions& options = {});

  std::size_t size() const { return n_; }
  /// In [0, 1]; symmetric. 0 if either image has no depth. Throws InvalidArgument if q or r is not
  /// below size().
  double overlap(std::size_t q, std::size_t r) const;
  /// First image connected to q; q itself if none before it is.
  std::size_t first_connected(std::size_t q) const;

  /// Scores detections as score_loops does, with three kinds of pairs: a row counts as a true loop
  /// if it holds a pair of overlap >= same; then every pair of at least `different` is right for
  /// it. In other rows such a pair is neither right nor wrong and its detection is left out.
  /// Detections of connected images are wrong where they are below `different`, and left out
  /// otherwise. Throws as score_loops.
  LoopScores score(Span<const LoopDetection> detections) const;

 private:
  std::size_t n_ = 0;
  LoopTruthOptions options_;
  std::vector<float> overlap_;  // n x n
  std::vector<std::size_t> first_connected_;
};

}  // namespace dynslam::evaluation
