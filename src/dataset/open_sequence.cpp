#include <cmath>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/readers.hpp"

#include "dataset/file_sequence.hpp"
#include "dataset/files.hpp"
#include "dataset/options.hpp"

namespace dynslam::dataset {

namespace fs = std::filesystem;

std::unique_ptr<Sequence> open_image_folder(const fs::path& folder, const DepthCamera& camera,
                                            double fps) {
  detail::validate_camera(camera, "open_image_folder");
  require(std::isfinite(fps) && fps > 0.0, "open_image_folder", "fps", fps, "a positive number");
  detail::FileSequenceData data;
  for (const fs::path& image : detail::list_images(folder)) {
    detail::FrameFiles frame;
    frame.timestamp = static_cast<double>(data.frames.size()) / fps;
    frame.name = image.stem().string();
    frame.color = image;
    data.frames.push_back(std::move(frame));
  }
  data.name = detail::folder_name(folder);
  data.camera = camera;
  data.fps = fps;
  return detail::make_file_sequence(std::move(data), folder);
}

FolderKind guess_folder_kind(const fs::path& folder) {
  detail::expect_folder(folder);
  const auto has = [&](const char* name) {
    std::error_code error;
    return fs::exists(folder / name, error);
  };
  if (has("mav0") || has("cam0")) return FolderKind::kEuroc;
  if (has("associations.txt") || has("rgb.txt")) return FolderKind::kTum;
  if (has("image_0") || has("image_2")) return FolderKind::kKitti;
  if (!detail::list_images(folder).empty()) return FolderKind::kImages;
  return FolderKind::kUnknown;
}

std::unique_ptr<Sequence> open_sequence(const fs::path& folder, const OpenOptions& options) {
  switch (guess_folder_kind(folder)) {
    case FolderKind::kTum: {
      TumOptions tum;
      tum.camera = options.camera;
      tum.depth_scale = options.depth_scale;
      tum.skip_disordered = options.skip_disordered;
      return open_tum(folder, tum);
    }
    case FolderKind::kKitti: {
      KittiOptions kitti;
      kitti.camera = options.camera;
      kitti.skip_disordered = options.skip_disordered;
      return open_kitti(folder, kitti);
    }
    case FolderKind::kEuroc: {
      require(!options.camera, "open_sequence", "camera", "a camera",
              "none for EuRoC, whose sensor.yaml says how to rectify");
      EurocOptions euroc;
      euroc.skip_disordered = options.skip_disordered;
      return open_euroc(folder, euroc);
    }
    case FolderKind::kImages:
      if (!options.camera) {
        throw_io_error(folder.string(),
                       "the camera of a plain folder of images is not known, expected one in the "
                       "options");
      }
      return open_image_folder(folder, *options.camera, options.fps);
    case FolderKind::kUnknown:
      break;
  }
  throw_io_error(folder.string(),
                 "is no sequence that is known, expected a TUM RGB-D folder (associations.txt or "
                 "rgb.txt), KITTI odometry (image_0), EuRoC (mav0) or images");
}

}  // namespace dynslam::dataset
