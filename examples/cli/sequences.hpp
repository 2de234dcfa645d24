// Where frames come from: the flags shared by the subcommands that read sequences.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <CLI/CLI.hpp>

#include "dynslam/dataset/sequence.hpp"

namespace dynslam::cli {

/// --tum | --kitti | --euroc | --scene with their companions.
struct SequenceFlags {
  std::string tum, kitti, euroc, scene;
  std::string camera;        ///< "FX,FY,CX,CY"; empty: the folder's
  double depth_scale = 0.0;  ///< 0: the folder's
  std::string frames;        ///< "FIRST:LAST"; empty: all
  std::uint64_t seed = 1;    ///< of a rendered scene
  bool stereo = false;       ///< render a scene for two cameras

  void add_to(CLI::App& command);
  /// Only those that say how to read: --camera, --depth-scale, --frames, --seed.
  void add_companions_to(CLI::App& command);
};

/// Opens what the flags name. Throws InvalidArgument or IoError with one clear sentence.
std::unique_ptr<dataset::Sequence> open_sequence(const SequenceFlags& flags);

/// Says on stderr which frames of a sequence are out of order and left out, if there are any.
void tell_left_out(const dataset::Sequence& sequence);

}  // namespace dynslam::cli
