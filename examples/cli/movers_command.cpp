// dynslam movers: what p-static takes for moving, held against true masks, feature by feature.
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/features/orb.hpp"

#include "commands.hpp"
#include "images.hpp"
#include "mask_source.hpp"
#include "progress.hpp"
#include "run_session.hpp"
#include "sequences.hpp"

namespace dynslam::cli {
namespace {

using Json = nlohmann::ordered_json;

struct MoversFlags {
  SequenceFlags input;
  RunFlags run;
  std::filesystem::path truth_masks;
  bool json = false;
};

/// How often a source said "dynamic", rightly and wrongly.
struct Tally {
  std::size_t true_positives = 0, false_positives = 0;
  std::map<int, std::size_t> found;  ///< by label

  void add(int label) {
    (label != 0 ? true_positives : false_positives) += 1;
    if (label != 0) ++found[label];
  }
};

/// Scores the features of all frames.
class Score {
 public:
  void add(const std::vector<cv::KeyPoint>& keypoints, const cv::Mat& labels,
           const cv::Mat& network, const slam::MoversView& movers) {
    for (const cv::KeyPoint& keypoint : keypoints) {
      const cv::Point at(cvRound(keypoint.pt.x), cvRound(keypoint.pt.y));
      const auto says = [&](const cv::Mat& mask) {
        return !mask.empty() && mask.at<std::uint8_t>(at) != 0;
      };
      const int label = labels.empty() ? 0 : labels.at<std::uint8_t>(at);
      ++of_label_[label];
      ++features_;
      const bool by_network = says(network);
      const bool moves = movers.mask.empty() ? by_network : says(movers.mask);
      if (by_network) network_.add(label);
      if (moves && !by_network) geometry_.add(label);
      if (moves) {
        all_.add(label);
      } else if (!says(movers.judged)) {
        ++unknown_;
      }
    }
  }

  Json report() const {
    Json values = {{"features", features_}};
    values.update(rates(all_));
    values["unknown_share"] = ratio(unknown_, features_);
    values["sources"] = {{"network", rates(network_)}, {"geometry", rates(geometry_)}};
    return values;
  }

 private:
  static Json ratio(std::size_t part, std::size_t whole) {
    return whole == 0 ? Json(nullptr)
                      : Json(static_cast<double>(part) / static_cast<double>(whole));
  }
  std::size_t count(int label) const {
    const auto found = of_label_.find(label);
    return found == of_label_.end() ? 0 : found->second;
  }
  Json rates(const Tally& tally) const {
    Json by_label = Json::object();
    for (const auto& [label, features] : of_label_) {
      if (label == 0) continue;
      const auto found = tally.found.find(label);
      by_label[std::to_string(label)] =
          ratio(found == tally.found.end() ? 0 : found->second, features);
    }
    return {
        {"precision", ratio(tally.true_positives, tally.true_positives + tally.false_positives)},
        {"recall", ratio(tally.true_positives, features_ - count(0))},
        {"false_positive_rate", ratio(tally.false_positives, count(0))},
        {"recall_by_label", by_label}};
  }

  Tally network_, geometry_, all_;  ///< geometry: what it adds to the network
  std::map<int, std::size_t> of_label_;
  std::size_t features_ = 0, unknown_ = 0;
};

// True labels of a frame: the folder's NAME.png, else what came with the sequence; empty: all
// static.
cv::Mat true_labels(const std::filesystem::path& folder, const dataset::Frame& frame) {
  if (folder.empty()) return frame.mask;
  const std::filesystem::path file = folder / (frame.name + ".png");
  const cv::Mat labels = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
  if (labels.empty()) throw_io_error(file.string(), "no readable mask");
  if (labels.size() != frame.color.size()) {
    throw_io_error(file.string(), "not of the image's size");
  }
  return labels;
}

// NaN of nothing.
double share_of(const Json& value) {
  return value.is_null() ? std::numeric_limits<double>::quiet_NaN() : value.get<double>();
}

void print_rates(const char* source, const Json& rates) {
  std::printf("%-10s  %9.3f  %6.3f  %19.4f", source, share_of(rates["precision"]),
              share_of(rates["recall"]), share_of(rates["false_positive_rate"]));
  for (const auto& [label, recall] : rates["recall_by_label"].items()) {
    std::printf("  %s: %.3f", label.c_str(), share_of(recall));
  }
  std::printf("\n");
}

void print_report(const Json& report) {
  std::printf("%zu features of %zu frames, %.1f %% of them not judged\n",
              report["features"].get<std::size_t>(), report["frames"].get<std::size_t>(),
              100.0 * share_of(report["unknown_share"]));
  std::printf("%-10s  %9s  %6s  %19s  recall by label\n", "source", "precision", "recall",
              "false positive rate");
  print_rates("all", report);
  for (const auto& [source, rates] : report["sources"].items()) print_rates(source.c_str(), rates);
}

int run(const MoversFlags& flags) {
  const std::unique_ptr<dataset::Sequence> sequence = open_sequence(flags.input);
  tell_left_out(*sequence);
  require_depth("movers", *sequence);
  slam::System system(sequence->camera(), composition_of(flags.run).options);
  MaskSource masks(flags.run, *sequence);
  features::OrbOptions orb;
  orb.max_features = flags.run.features;
  features::OrbExtractor extractor(orb);
  Score score;
  std::vector<double> ms;
  Progress progress("movers", sequence->size());
  for (std::size_t i = 0; i < sequence->size(); ++i) {
    const dataset::Frame frame = sequence->read(i);
    const cv::Mat labels = true_labels(flags.truth_masks, frame);
    FrameRow row;
    const cv::Mat& mask = masks.update(frame, row);
    ms.push_back(system.track({frame.timestamp, frame.color, frame.depth, mask}).ms.geometry);
    const cv::Mat gray = gray_of(frame.color);
    cv::Mat descriptors;
    std::vector<cv::KeyPoint> keypoints;
    extractor.extract(as_view<const std::uint8_t>(gray), {}, keypoints, descriptors);
    score.add(keypoints, labels, mask, system.movers());
    progress.update(i + 1, "");
  }
  const SegmenterFailures unsegmented = masks.finish();
  tell(unsegmented);
  Json report = score.report();
  report["unsegmented"] = unsegmented.count;
  report["frames"] = sequence->size();
  report["ms"] = {{"median", evaluation::quantile(ms, 0.5)}};
  if (flags.json) {
    std::cout << report.dump(2) << '\n';
  } else {
    print_report(report);
  }
  return 0;
}

}  // namespace

CLI::App* add_movers_command(CLI::App& app, std::function<int()>& work) {
  auto flags = std::make_shared<MoversFlags>();
  CLI::App* command = app.add_subcommand("movers", "score what is taken for moving against masks");
  command->footer("Example:\n  dynslam movers --tum DIR --truth-masks DIR/mask --segmenter none");
  flags->input.add_to(*command);
  flags->run.dilation_px = 0;  // the verdict on a feature, without a margin around it
  add_segmenter_flags(*command, flags->run);
  command
      ->add_option("--truth-masks", flags->truth_masks,
                   "folder of true masks, NAME.png, 0 = static; else those of the sequence; else "
                   "all counts as static")
      ->check(CLI::ExistingDirectory);
  command->add_option("--features", flags->run.features, "ORB features a frame")
      ->check(CLI::Range(100, 20000))
      ->capture_default_str();
  command->add_option("--without", flags->run.without, "parts of the system to switch off")
      ->delimiter(',')
      ->check(CLI::IsMember({"geometry", "weights"}));
  command->add_flag("--json", flags->json, "print one JSON object");
  command->callback([flags, &work] { work = [flags] { return run(*flags); }; });
  return command;
}

}  // namespace dynslam::cli
