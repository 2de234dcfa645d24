// Descriptors to train a vocabulary from: of images, or of files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "dynslam/core/image_view.hpp"

namespace dynslam::cli {

struct TrainingSet {
  std::vector<std::uint8_t> bytes;
  int descriptor_bytes = 0;
  std::vector<std::size_t> image_ends;  // rows
  std::size_t images = 0;               // pictures among them
  std::size_t files = 0;                // descriptor files among them

  std::size_t rows() const {
    return descriptor_bytes == 0 ? 0 : bytes.size() / static_cast<std::size_t>(descriptor_bytes);
  }
  DescriptorsView view() const;
};

/// ORB descriptors of pictures and rows of .npy files (uint8, a descriptor a row, a file an image).
/// `paths` are files, or folders that are searched with all that is below, in the order of names.
/// `every`: only every n-th picture of a folder. Masks and depth of TUM folders are left out.
TrainingSet read_training_set(const std::vector<std::string>& paths, int features,
                              std::size_t every, int threads);

}  // namespace dynslam::cli
