// Masks for the frames of a run: made while the frame waits, or on a thread beside tracking.
#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>
#include <opencv2/core/mat.hpp>

#include "dynslam/dataset/sequence.hpp"
#include "dynslam/segmentation/async_segmenter.hpp"
#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/segmentation/mask_propagation.hpp"

#include "run_session.hpp"

namespace dynslam::cli {

/// --segmenter, --backend and what becomes of the masks.
void add_segmenter_flags(CLI::App& command, RunFlags& flags);

/// Threads for each of two that work at once: half of the cores.
int threads_beside_tracking();

class MaskSource {
 public:
  /// Loads the segmenter that the flags name, if their system uses masks. With
  /// `flags.asynchronous()` it gets a thread. `sequence` has to outlive the source.
  MaskSource(const RunFlags& flags, const dataset::Sequence& sequence);

  /// Segments the first frame, so that the network is warm and the first mask there when the clock
  /// starts. Only the asynchronous source needs it.
  void prepare(const dataset::Frame& first);

  /// The dynamic mask of a frame, empty without a segmenter; fills the row's columns about it.
  /// A segmenter that fails costs masks, not the run, unless it fails from the start.
  const cv::Mat& update(const dataset::Frame& frame, FrameRow& row);

  SegmenterFailures failures() const;

 private:
  void update_now(const dataset::Frame& frame, FrameRow& row);
  void segment(const dataset::Frame& frame);
  void update_beside(const dataset::Frame& frame, FrameRow& row);

  int every_;
  bool truth_;  // the frames' own masks
  int age_ = 0;
  bool worked_ = false;
  std::size_t failures_ = 0;
  std::string first_failure_;
  segmentation::MaskPolicy policy_;
  std::unique_ptr<segmentation::Segmenter> segmenter_;        // synchronous
  std::unique_ptr<segmentation::AsyncSegmenter> worker_;      // or asynchronous
  std::unique_ptr<segmentation::MaskPropagator> propagator_;  // with the worker
  cv::Mat mask_;
};

}  // namespace dynslam::cli
