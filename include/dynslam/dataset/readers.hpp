// Readers of the folders in which data sets are published.
//
// Opening reads the index files and the header of the first image only; images are read by
// `Sequence::read`. A folder that is missing, empty, incomplete or corrupt throws IoError that
// names the file, the line where there is one, and what was expected. Readers start no threads;
// OpenCV may use its own when it decodes and remaps.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "dynslam/core/camera.hpp"
#include "dynslam/dataset/sequence.hpp"

namespace dynslam::dataset {

/// How to open a TUM RGB-D folder.
struct TumOptions {
  /// Replaces camera.txt and the known calibration; without distortion. Width and height 0: as the
  /// images are.
  std::optional<DepthCamera> camera;
  /// Units of the depth image a metre, > 0; replaces the folder's. Without any: 5000 (TUM).
  std::optional<double> depth_scale;
  /// Seconds, >= 0: largest difference between a colour image and its depth image (TUM: 0.02).
  double max_time_difference = 0.02;
  /// Seconds, >= 0: between truth poses farther apart than this a frame has no pose (engineering).
  double max_truth_gap = 0.2;
  /// Leave out rows whose time does not increase, and count them in `report()`, instead of
  /// throwing.
  bool skip_disordered = false;
  /// Remove the lens distortion that the calibration has (colour bilinear; depth and mask nearest).
  bool undistort = true;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// TUM RGB-D layout, also that of Bonn RGB-D Dynamic and of `TumWriter`.
///
/// associations.txt if there, else rgb.txt with depth.txt associated by time, else rgb.txt alone
/// (kMono). groundtruth.txt and mask/<stem>.png are optional. Camera: options, else camera.txt,
/// else the published calibration by the folder's name (`known_tum_camera`), else IoError that asks
/// for one. Depth is 16-bit grey, of the size of the colour image; `Frame::timestamp` is the colour
/// image's. bf defaults to the virtual baseline of 40 / 525 m.
std::unique_ptr<Sequence> open_tum(const std::filesystem::path& folder,
                                   const TumOptions& options = {});

/// How to open a KITTI odometry folder.
struct KittiOptions {
  /// Replaces the intrinsics of calib.txt; the stereo baseline stays calib.txt's if there is one.
  /// Width and height 0: as the images are.
  std::optional<DepthCamera> camera;
  /// Use image_2 / image_3 where both grey and colour are there.
  bool prefer_color = false;
  /// Leave image_1 / image_3 alone: kMono.
  bool left_only = false;
  /// See TumOptions.
  bool skip_disordered = false;

  void validate() const;
};

/// KITTI odometry: a folder with image_0 (image_1, image_2, image_3), calib.txt, times.txt and
/// poses.txt, or the official sequences/NN with the truth in ../../poses/NN.txt.
///
/// Images are in natural order of their names. Rows of times.txt and poses.txt go by position if
/// there are as many as images, else by the number that is the image's name (a sequence that was
/// cut). Without times.txt the frames are 0.1 s apart. An image without a time is an IoError; poses
/// may end early, then the later frames have none.
///
/// kStereo when the right folder exists; it must hold the same names. The poses are those of the
/// left grey camera; with colour images they are moved by the offset in P2. Masks as in `open_tum`.
std::unique_ptr<Sequence> open_kitti(const std::filesystem::path& folder,
                                     const KittiOptions& options = {});

/// How to open a EuRoC folder.
struct EurocOptions {
  /// Leave cam1 alone: kMono with cam0's own pinhole.
  bool left_only = false;
  /// Seconds, >= 0: largest difference between the left and the right image's times (engineering).
  double max_time_difference = 0.002;
  /// Seconds, >= 0. See TumOptions.
  double max_truth_gap = 0.2;
  /// See TumOptions.
  bool skip_disordered = false;

  void validate() const;
};

/// EuRoC (ASL) layout: the folder itself or its mav0/, with cam0, cam1 (then kStereo) and
/// state_groundtruth_estimate0 (optional).
///
/// Distortion is removed on reading; a stereo pair is rectified (Bouguet, through
/// cv::stereoRectify with alpha = 0) by T_BS. The truth is the pose of `Frame::color`'s camera:
/// T_world_body T_BS, turned by the rectifying rotation.
std::unique_ptr<Sequence> open_euroc(const std::filesystem::path& folder,
                                     const EurocOptions& options = {});

/// A plain folder of images in natural order of their names, 1 / fps seconds apart from 0: kMono
/// without truth. Width and height 0 in `camera` mean: as the images are. Throws InvalidArgument
/// for an invalid camera or fps.
std::unique_ptr<Sequence> open_image_folder(const std::filesystem::path& folder,
                                            const DepthCamera& camera, double fps = 30.0);

/// What `open_sequence` takes a folder for.
enum class FolderKind { kUnknown, kTum, kKitti, kEuroc, kImages };

/// By what lies in the folder: mav0/ or cam0/ -> EuRoC; associations.txt or rgb.txt -> TUM;
/// image_0/ or image_2/ -> KITTI; image files -> images. Throws IoError if it is no folder.
FolderKind guess_folder_kind(const std::filesystem::path& folder);

/// How to open a folder of a kind yet unknown: what applies to that kind is used, the rest is not.
struct OpenOptions {
  std::optional<DepthCamera> camera;  ///< see TumOptions; EuRoC refuses it
  std::optional<double> depth_scale;  ///< see TumOptions
  double fps = 30.0;                  ///< of a plain folder of images
  bool skip_disordered = false;       ///< see TumOptions
};

/// Opens a folder by its `guess_folder_kind`. Throws IoError if it is none of the known kinds, and
/// for a plain folder of images without `camera`; InvalidArgument for a camera given for EuRoC.
std::unique_ptr<Sequence> open_sequence(const std::filesystem::path& folder,
                                        const OpenOptions& options = {});

}  // namespace dynslam::dataset
