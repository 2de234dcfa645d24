// Masks for the frames of a run: made while the frame waits, or on a thread beside tracking.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

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

/// Says on stderr at how many frames a segmenter failed, if it did.
void tell(const SegmenterFailures& failures);

/// Every segmenter but the truth works on a thread of its own, so that one that hangs costs masks
/// and not the run.
class MaskSource {
 public:
  /// Loads the segmenter that the flags name, if their system uses masks. With
  /// `flags.asynchronous()` nobody waits for it. `sequence` has to outlive the source.
  MaskSource(const RunFlags& flags, const dataset::Sequence& sequence);

  /// Segments the first frame, so that the network is warm and the first mask there when the clock
  /// starts. Only the asynchronous source needs it.
  void prepare(const dataset::Frame& first);

  /// The dynamic mask of a frame, empty without a segmenter; fills the row's columns about it.
  /// A segmenter that fails costs masks, not the run.
  const cv::Mat& update(const dataset::Frame& frame, FrameRow& row);

  /// After the last frame: lets the segmenter finish and tells at how many frames it failed.
  SegmenterFailures finish();

 private:
  void update_now(const dataset::Frame& frame, FrameRow& row);
  void segment(const dataset::Frame& frame);
  std::optional<segmentation::Segmentation> segmentation_of(const dataset::Frame& frame);
  void update_beside(const dataset::Frame& frame, FrameRow& row);

  int every_;
  bool truth_ = false;  // the frames' own masks
  int age_ = 0;
  std::size_t failures_ = 0;  // of a segmenter that is waited for
  segmentation::MaskPolicy policy_;
  std::vector<std::string> names_;                            // of the classes
  std::unique_ptr<segmentation::AsyncSegmenter> worker_;      // none for the frames' own masks
  std::unique_ptr<segmentation::MaskPropagator> propagator_;  // if nobody waits for the worker
  cv::Mat mask_;
};

}  // namespace dynslam::cli
