#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <nlohmann/json.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/core/so3.hpp"
#include "dynslam/dataset/readers.hpp"
#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/matching/named_rule.hpp"
#include "dynslam/matching/opencv.hpp"
#include "dynslam/matching/reject.hpp"

#include "checks.hpp"
#include "commands.hpp"
#include "images.hpp"

namespace dynslam::cli {
namespace {

using json = nlohmann::json;
using Clock = std::chrono::steady_clock;

constexpr double kGoodPixels = 2.0;  // both epipolar distances of a good match are below this

struct MatchOptions {
  std::string tum, kitti;
  std::size_t gap = 15;
  int features = 500;
  std::string extractor = "dynslam";
  std::vector<std::string> rules;
  bool json = false;
};

struct PosedImage {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  std::optional<RigidTransform> T_world_cam;
};

/// Features and poses of all frames.
class Views {
 public:
  explicit Views(const MatchOptions& options) {
    std::unique_ptr<dataset::Sequence> sequence;
    if (!options.tum.empty()) {
      sequence = dataset::open_tum(options.tum);
    } else {
      dataset::KittiOptions kitti;
      kitti.left_only = true;
      sequence = dataset::open_kitti(options.kitti, kitti);
    }
    camera_ = sequence->camera();
    features::OrbOptions orb;
    orb.max_features = options.features;
    features::OrbExtractor ours(orb);
    const cv::Ptr<cv::ORB> opencv = cv::ORB::create(options.features);
    for (std::size_t i = 0; i < sequence->size(); ++i) {
      const dataset::Frame frame = sequence->read(i);
      const cv::Mat gray = gray_of(frame.color);
      PosedImage view;
      view.T_world_cam = frame.T_world_cam;
      if (options.extractor == "opencv") {
        opencv->detectAndCompute(gray, cv::noArray(), view.keypoints, view.descriptors);
      } else {
        ours.extract(as_view<const std::uint8_t>(gray), {}, view.keypoints, view.descriptors);
      }
      views_.push_back(std::move(view));
    }
  }

  std::size_t size() const { return views_.size(); }
  const PosedImage& operator[](std::size_t i) const { return views_[i]; }
  Eigen::Matrix3d intrinsics() const {
    Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
    k(0, 0) = camera_.fx, k(1, 1) = camera_.fy, k(0, 2) = camera_.cx, k(1, 2) = camera_.cy;
    return k;
  }

 private:
  DepthCamera camera_;
  std::vector<PosedImage> views_;
};

/// Tells good matches by the true relative pose.
class Truth {
 public:
  Truth(const RigidTransform& T_world_cam1, const RigidTransform& T_world_cam2,
        const Eigen::Matrix3d& k) {
    const RigidTransform T_cam2_cam1 = T_world_cam2.inverse() * T_world_cam1;
    const Eigen::Matrix3d k_inverse = k.inverse();
    homography_ = k * T_cam2_cam1.R * k_inverse;
    still_ = T_cam2_cam1.t.norm() < 1e-6;  // metres; then there is no epipolar geometry
    f_ = k_inverse.transpose() * skew(T_cam2_cam1.t) * T_cam2_cam1.R * k_inverse;
  }

  bool is_good(const cv::Point2f& a, const cv::Point2f& b) const {
    const Eigen::Vector3d p(a.x, a.y, 1.0), q(b.x, b.y, 1.0);
    if (still_) return ((homography_ * p).hnormalized() - q.head<2>()).norm() < kGoodPixels;
    const Eigen::Vector3d line2 = f_ * p, line1 = f_.transpose() * q;
    const double e = std::abs(q.dot(line2));
    return e < kGoodPixels * line2.head<2>().norm() && e < kGoodPixels * line1.head<2>().norm();
  }

 private:
  Eigen::Matrix3d homography_, f_;
  bool still_ = false;
};

/// Means over pairs; of the time the median, since the machine may be busy with other things.
struct MatchScore {
  void add(const std::vector<std::uint8_t>& keep, const std::vector<std::uint8_t>& good,
           double milliseconds) {
    double both = 0, kept = 0, right = 0;
    for (std::size_t i = 0; i < good.size(); ++i) {
      both += keep[i] != 0 && good[i] != 0;
      kept += keep[i] != 0;
      right += good[i] != 0;
    }
    const double p = kept > 0 ? both / kept : 0.0;
    const double r = right > 0 ? both / right : 0.0;
    precision += p;
    recall += r;
    f1 += p + r > 0 ? 2 * p * r / (p + r) : 0.0;
    ms.push_back(milliseconds);
    ++pairs;
  }

  json report() const {
    const double n = static_cast<double>(pairs);
    return {{"precision", precision / n},
            {"recall", recall / n},
            {"f1", f1 / n},
            {"ms", evaluation::quantile(ms, 0.5)}};
  }

  double precision = 0, recall = 0, f1 = 0;
  std::vector<double> ms;
  std::size_t pairs = 0;
};

struct Rival {
  const char* name;
  int method;
};
constexpr Rival kRivals[] = {
    {"usac_magsac", cv::USAC_MAGSAC}, {"usac_fast", cv::USAC_FAST}, {"fm_ransac", cv::FM_RANSAC}};

class MatchRun {
 public:
  explicit MatchRun(const MatchOptions& options) : options_(options) {
    if (options_.rules.empty()) {
      for (const auto name : matching::kRuleNames) rules_.push_back(matching::make_rule(name));
    }
    for (const std::string& name : options_.rules) rules_.push_back(matching::make_rule(name));
    rule_scores_.resize(rules_.size());
  }

  int operator()() {
    cv::setNumThreads(1);  // one thread for us and for the rivals
    const Views views(options_);
    for (std::size_t i = 0; i + options_.gap < views.size(); ++i) {
      compare(views[i], views[i + options_.gap], views.intrinsics());
    }
    if (pairs_ == 0) {
      throw InvalidArgument("match: no two frames " + std::to_string(options_.gap) +
                            " apart have features and true poses");
    }
    finish();
    return 0;
  }

 private:
  void compare(const PosedImage& a, const PosedImage& b, const Eigen::Matrix3d& k) {
    if (!a.T_world_cam || !b.T_world_cam || a.keypoints.empty() || b.keypoints.size() < 2) return;
    std::vector<std::vector<cv::DMatch>> nearest;
    matcher_.knnMatch(a.descriptors, b.descriptors, nearest, 2);
    const Truth truth(*a.T_world_cam, *b.T_world_cam, k);
    std::vector<cv::DMatch> matches;
    std::vector<cv::Point2f> points1, points2;
    std::vector<std::uint8_t> good, ratio;
    for (const auto& two : nearest) {
      const cv::Point2f p = a.keypoints[static_cast<std::size_t>(two[0].queryIdx)].pt;
      const cv::Point2f q = b.keypoints[static_cast<std::size_t>(two[0].trainIdx)].pt;
      matches.push_back(two[0]);
      points1.push_back(p);
      points2.push_back(q);
      good.push_back(truth.is_good(p, q) ? 1 : 0);
      ratio.push_back(two[0].distance < 0.8F * two[1].distance ? 1 : 0);
    }
    ++pairs_;
    matches_ += matches.size();
    for (const std::uint8_t flag : good) good_ += flag;
    score_rules(a, b, matches, good);
    score_rivals(points1, points2, good);
    ratio_score_.add(ratio, good, 0.0);
  }

  void score_rules(const PosedImage& a, const PosedImage& b, const std::vector<cv::DMatch>& matches,
                   const std::vector<std::uint8_t>& good) {
    std::vector<std::uint8_t> keep(matches.size());
    std::vector<float> weight(matches.size());
    for (std::size_t r = 0; r < rules_.size(); ++r) {
      const auto start = Clock::now();
      matching::reject(rules_[r], matches, a.keypoints, b.keypoints, keep, weight, workspace_);
      rule_scores_[r].add(keep, good, since(start));
    }
  }

  void score_rivals(const std::vector<cv::Point2f>& points1,
                    const std::vector<cv::Point2f>& points2,
                    const std::vector<std::uint8_t>& good) {
    for (std::size_t r = 0; r < std::size(kRivals); ++r) {
      std::vector<std::uint8_t> mask;
      const auto start = Clock::now();
      try {
        cv::findFundamentalMat(points1, points2, kRivals[r].method, 2.0, 0.999, 1000, mask);
      } catch (const cv::Exception&) {
        mask.clear();  // too few matches for OpenCV: it finds nothing
      }
      const double ms = since(start);
      mask.resize(good.size(), 0);
      rival_scores_[r].add(mask, good, ms);
    }
  }

  static double since(Clock::time_point start) {
    return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  }

  void finish() const {
    const double n = static_cast<double>(pairs_);
    json rules, rivals;
    for (std::size_t r = 0; r < rules_.size(); ++r) {
      rules[std::string(rules_[r].name())] = rule_scores_[r].report();
    }
    for (std::size_t r = 0; r < std::size(kRivals); ++r) {
      rivals[kRivals[r].name] = rival_scores_[r].report();
    }
    rivals["ratio"] = ratio_score_.report();
    const json report = {{"pairs", pairs_},
                         {"matches_mean", static_cast<double>(matches_) / n},
                         {"good_mean", static_cast<double>(good_) / n},
                         {"gap", options_.gap},
                         {"features", options_.features},
                         {"extractor", options_.extractor},
                         {"rules", rules},
                         {"rivals", rivals}};
    if (options_.json) {
      std::cout << report.dump() << '\n';
      return;
    }
    std::printf("%zu pairs, %.0f matches each, %.0f good\n", pairs_,
                report["matches_mean"].get<double>(), report["good_mean"].get<double>());
    std::printf("%-20s %9s %9s %9s %9s\n", "", "precision", "recall", "F1", "ms");
    for (const char* group : {"rules", "rivals"}) {
      for (const auto& [name, s] : report[group].items()) {
        std::printf("%-20s %9.3f %9.3f %9.3f %9.3f\n", name.c_str(), s["precision"].get<double>(),
                    s["recall"].get<double>(), s["f1"].get<double>(), s["ms"].get<double>());
      }
    }
  }

  MatchOptions options_;
  std::vector<matching::NamedRule> rules_;
  std::vector<MatchScore> rule_scores_;
  MatchScore rival_scores_[std::size(kRivals)];
  MatchScore ratio_score_;
  cv::BFMatcher matcher_{cv::NORM_HAMMING};
  matching::Workspace workspace_;
  std::size_t pairs_ = 0, matches_ = 0, good_ = 0;
};

}  // namespace

CLI::App* add_match_command(CLI::App& app, std::function<int()>& run) {
  auto options = std::make_shared<MatchOptions>();
  CLI::App* command = app.add_subcommand("match", "score match rejection against true poses");
  command->footer(
      "Example: dynslam match --tum DIR --gap 15 --rule default --rule ModalBin --json");
  CLI::Option* tum = command->add_option("--tum", options->tum, "recording in TUM RGB-D layout");
  CLI::Option* kitti =
      command->add_option("--kitti", options->kitti, "sequence in KITTI odometry layout");
  tum->excludes(kitti);
  CLI::Option* gap =
      command->add_option("--gap", options->gap, "frames between the two images (15; KITTI 3)")
          ->check(CLI::Range(1, 1000000));
  command->add_option("--features", options->features, "ORB features an image")
      ->check(CLI::Range(10, 100000))
      ->capture_default_str();
  command->add_option("--extractor", options->extractor, "whose ORB")
      ->check(CLI::IsMember({"dynslam", "opencv"}))
      ->capture_default_str();
  std::string names;
  for (const auto name : matching::kRuleNames)
    names += (names.empty() ? "" : " | ") + std::string(name);
  command->add_option("--rule", options->rules, names + "; may be given again; default: all")
      ->check(readable_by([](const std::string& name) { matching::make_rule(name); }));
  command->add_flag("--json", options->json, "print one JSON object and nothing else");
  command->callback([options, gap, &run] {
    if (options->tum.empty() && options->kitti.empty()) {
      throw CLI::ValidationError("match", "give --tum DIR or --kitti DIR");
    }
    if (gap->count() == 0 && !options->kitti.empty()) options->gap = 3;
    run = [options] { return MatchRun(*options)(); };
  });
  return command;
}

}  // namespace dynslam::cli
