// Settings of loop closing.
#pragma once

#include <cstddef>

namespace dynslam::slam {

/// How loops are found and closed, and lost cameras recognized.
struct LoopOptions {
  /// Off: no loops; a lost camera is looked for in all keyframes in turn.
  bool enabled = true;
  /// Keyframes from which a vocabulary is trained where none is given, >= 2; trained again whenever
  /// the map has twice as many. Engineering: a look-alike needs a few places to differ from.
  int first_vocabulary = 10;
  /// Keyframes in a row that must point to the same place, and that must have missed it before, >=
  /// 1. Source: 3, Mur-Artal et al. 2015.
  int consistency = 3;
  /// Map points of the old place that a keyframe must confirm in pixels and, where there is any,
  /// depth, >= 6. Source: the field's habit of 40.
  int min_inliers = 40;
  /// Share of the image, where it should show map points of the old place, that must confirm them,
  /// [0, 1]: an object carried elsewhere brings its own points, not those around it. Cells of an
  /// eighth of the width count if a fifth of their points is found. Engineering: people in front of
  /// the place may hide half of it.
  double min_confirmed = 0.5;
  /// Refine the whole map after a loop.
  bool bundle_adjustment = true;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

}  // namespace dynslam::slam
