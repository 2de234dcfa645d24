// Writes a sequence as a folder in TUM RGB-D layout.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>

#include "dynslam/core/camera.hpp"
#include "dynslam/dataset/sequence.hpp"

namespace dynslam::dataset {

struct TumWriterOptions {
  double depth_scale = 5000.0;  ///< units of the depth image a metre, > 0 (TUM)
  double fps = 30.0;            ///< frames a second, > 0; for camera.txt
  int png_compression = 1;      ///< 0 (fast) .. 9 (small); OpenCV's default is 1
  bool overwrite = false;       ///< replace a sequence that is already in the folder

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Writes rgb/*.png, depth/*.png (16 bit), mask/*.png, and at `finish` groundtruth.txt, camera.txt,
/// depth.txt, rgb.txt and, last of all, associations.txt.
///
/// Every file appears complete or not at all, and the index files come last, so a folder
/// whose writing was cut short has no index and no reader takes it for a whole. Nothing is written
/// at destruction: without `finish` the folder stays unfinished. Times are written with 6 digits
/// after the point, which are also the file names.
///
/// Not thread-safe.
class TumWriter {
 public:
  /// Makes the folder. Throws InvalidArgument for an invalid camera or options; IoError if the
  /// folder cannot be made, or holds a sequence already and `overwrite` is false. With `overwrite`
  /// the old index files are removed here; old images stay where no new one replaces them.
  TumWriter(const std::filesystem::path& folder, const DepthCamera& camera,
            const TumWriterOptions& options = {});
  ~TumWriter();
  TumWriter(const TumWriter&) = delete;
  TumWriter& operator=(const TumWriter&) = delete;

  /// Writes a frame's images. Depth that is not finite, not positive, or too far for 16 bits is
  /// written as 0, none; else it is rounded to the nearest unit. `name`, `index` and `right` are
  /// not written.
  ///
  /// Throws InvalidArgument if colour, depth or mask has another type or size than the camera's
  /// frames, depth is there for some frames only, a pose or time is not finite, or the time does
  /// not increase by at least 1e-6 s; IoError if a file cannot be written (disk full included).
  /// After an error the frame is not part of the sequence and the writer can still be used.
  void add(const Frame& frame);

  /// Writes the index files. Throws InvalidArgument if there is no frame or it was called before;
  /// IoError as above.
  void finish();

  /// Frames added.
  std::size_t size() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// Writes all frames of a sequence, with its camera and frames a second (`options.fps` is not
/// used). The truth is that of the frames. Throws as TumWriter and `Sequence::read` do. Returns the
/// number of frames.
std::size_t write_tum_folder(const Sequence& sequence, const std::filesystem::path& folder,
                             const TumWriterOptions& options = {});

}  // namespace dynslam::dataset
