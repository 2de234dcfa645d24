#include <iostream>
#include <string>

#include "dynslam/attention/onnx_fuse.hpp"
#include "dynslam/attention/opencv.hpp"

#include "commands.hpp"

namespace dynslam::cli {

void add_fuse_command(CLI::App& app, std::function<int()>& run) {
  // Networks that were fused run in every command that takes one.
  attention::register_opencv_layers();
  CLI::App* command = app.add_subcommand(
      "fuse", "replace Ghost, DFC and CBAM layers in an ONNX network by fused ones");
  static std::string input, output;
  command->add_option("input", input, "the network as exported")->required();
  command->add_option("output", output, "where the fused network goes")->required();
  command->footer(
      "Example:\n  dynslam fuse ghost.onnx fused.onnx\n"
      "  dynslam segment yolo-seg:fused.onnx --tum DIR");
  command->callback([&run] {
    run = [] {
      const attention::OnnxFusion fusion = attention::fuse_onnx_file(input, output);
      std::cout << "GhostV2C3 " << fusion.ghost_c3 << ", Ghost bottleneck "
                << fusion.ghost_bottleneck << ", Ghost module " << fusion.ghost_module << ", DFC "
                << fusion.dfc << ", CBAM " << fusion.cbam << "; " << fusion.nodes_before
                << " nodes before, " << fusion.nodes_after << " after\n";
      return 0;
    };
  });
}

}  // namespace dynslam::cli
