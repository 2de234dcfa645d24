#include "loops_session.hpp"

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <thread>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/dataset/readers.hpp"
#include "dynslam/evaluation/loop_truth.hpp"
#include "dynslam/features/orb.hpp"
#include "dynslam/loop/verification.hpp"
#include "dynslam/loop/vocabulary_io.hpp"
#include "dynslam/loop/vocabulary_training.hpp"

#include "images.hpp"
#include "progress.hpp"

namespace dynslam::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

double since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

// "2.jpg" before "10.jpg": runs of digits compare as numbers.
bool natural_less(const std::string& a, const std::string& b) {
  const auto digit = [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; };
  std::size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (!digit(a[i]) || !digit(b[j])) {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i, ++j;
      continue;
    }
    while (i < a.size() && a[i] == '0') ++i;
    while (j < b.size() && b[j] == '0') ++j;
    const std::size_t first_i = i, first_j = j;
    while (i < a.size() && digit(a[i])) ++i;
    while (j < b.size() && digit(b[j])) ++j;
    if (i - first_i != j - first_j) return i - first_i < j - first_j;
    const int order = a.compare(first_i, i - first_i, b, first_j, j - first_j);
    if (order != 0) return order < 0;
  }
  return a.size() - i < b.size() - j;
}

std::vector<std::string> image_files(const LoopsOptions& options) {
  std::vector<std::string> files;
  const auto is_truth = [&](const fs::path& path) {
    std::error_code error;
    return !options.truth.empty() && fs::equivalent(path, options.truth, error);
  };
  for (const std::string& name : options.images) {
    std::error_code error;
    if (!fs::is_directory(name, error)) {
      files.push_back(name);
      continue;
    }
    std::vector<std::string> found;
    for (const auto& entry : fs::directory_iterator(name)) {
      if (entry.is_regular_file() && cv::haveImageReader(entry.path().string()) &&
          !is_truth(entry.path()))
        found.push_back(entry.path().string());
    }
    std::sort(found.begin(), found.end(), natural_less);
    files.insert(files.end(), found.begin(), found.end());
  }
  if (files.size() < 2) throw InvalidArgument("loops: fewer than 2 images were given");
  return files;
}

struct View {
  int width = 0, height = 0;
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  cv::Mat depth;
  Eigen::Matrix3Xd points;  // of each key point in the camera, NaN where there is no depth
  loop::BowVector bow;
  loop::FeatureVector direct;
};

/// Images with features, and what is known about the truth.
class Places {
 public:
  Places(const LoopsOptions& options, LoopsOutcome& outcome)
      : extractor_(orb_options(options.features)) {
    if (options.tum.empty()) {
      read_images(options, outcome);
    } else {
      read_tum(options.tum, outcome);
    }
  }

  std::size_t size() const { return views_.size(); }
  View& operator[](std::size_t i) { return views_[i]; }
  bool has_depth() const { return truth_.has_value(); }
  const DepthCamera& camera() const { return camera_; }

  /// What a map would call covisible with an image; empty without poses.
  std::vector<std::uint64_t> covisible(std::size_t q) const {
    std::vector<std::uint64_t> ids;
    for (std::size_t r = truth_ ? truth_->first_connected(q) : q; r < q; ++r) ids.push_back(r);
    return ids;
  }

  /// Distance between where a verification puts the query's camera and where it was, metres.
  double pose_error(const loop::LoopResult& result) const {
    const RigidTransform truth = poses_[result.match].inverse() * poses_[result.query];
    return (result.verification.T_candidate_query.t - truth.t).norm();
  }

  evaluation::LoopScores score(const std::vector<evaluation::LoopDetection>& detections) const {
    if (truth_) return truth_->score(detections);
    return evaluation::score_loops(as_view<const std::uint8_t>(matrix_), detections);
  }

 private:
  static features::OrbOptions orb_options(int count) {
    features::OrbOptions options;
    options.max_features = count;
    return options;
  }

  View& extract(const cv::Mat& color, LoopsOutcome& outcome) {
    const cv::Mat gray = gray_of(color);
    View view;
    view.width = gray.cols;
    view.height = gray.rows;
    const auto start = Clock::now();
    extractor_.extract(as_view<const std::uint8_t>(gray), {}, view.keypoints, view.descriptors);
    outcome.extract_ms.push_back(since(start));
    views_.push_back(std::move(view));
    return views_.back();
  }

  void read_images(const LoopsOptions& options, LoopsOutcome& outcome) {
    matrix_ = cv::imread(options.truth, cv::IMREAD_GRAYSCALE);
    if (matrix_.empty()) throw_io_error(options.truth, "cannot be read as an image");
    const std::vector<std::string> files = image_files(options);
    const auto count = static_cast<int>(files.size());
    if (matrix_.rows != count || matrix_.cols != count) {
      throw InvalidArgument(options.truth + ": has " + std::to_string(matrix_.cols) + " x " +
                            std::to_string(matrix_.rows) + " pixels, expected one row and column " +
                            "for each of " + std::to_string(count) + " images");
    }
    Progress progress("features", files.size());
    for (std::size_t i = 0; i < files.size(); ++i) {
      const cv::Mat image = cv::imread(files[i], cv::IMREAD_GRAYSCALE);
      if (image.empty()) throw_io_error(files[i], "cannot be read as an image");
      extract(image, outcome);
      progress.update(i + 1);
    }
  }

  void read_tum(const std::string& folder, LoopsOutcome& outcome) {
    const auto sequence = dataset::open_tum(folder);
    camera_ = sequence->camera();
    std::vector<evaluation::PlaceView> place_views;
    Progress progress("features", sequence->size());
    for (std::size_t i = 0; i < sequence->size(); ++i) {
      const dataset::Frame frame = sequence->read(i);
      progress.update(i + 1);
      if (!frame.T_world_cam || frame.depth.empty()) continue;  // nothing to score it by
      View& view = extract(frame.color, outcome);
      view.depth = frame.depth;
      view.points = unproject(view.keypoints, frame.depth);
      poses_.push_back(*frame.T_world_cam);
      place_views.push_back({*frame.T_world_cam, as_view<const float>(frame.depth)});
    }
    if (views_.size() < 2) throw_io_error(folder, "fewer than 2 frames have a true pose and depth");
    truth_.emplace(place_views, camera_);
  }

  Eigen::Matrix3Xd unproject(const std::vector<cv::KeyPoint>& keypoints,
                             const cv::Mat& depth) const {
    Eigen::Matrix3Xd points(3, static_cast<Eigen::Index>(keypoints.size()));
    for (std::size_t i = 0; i < keypoints.size(); ++i) {
      const cv::Point2f p = keypoints[i].pt;
      const float z = depth.at<float>(cvRound(p.y), cvRound(p.x));
      points.col(static_cast<Eigen::Index>(i)) =
          z > 0.0F ? camera_.unproject({p.x, p.y}, z)
                   : Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
    }
    return points;
  }

  features::OrbExtractor extractor_;
  std::vector<View> views_;
  cv::Mat matrix_;
  DepthCamera camera_;
  std::vector<RigidTransform> poses_;
  std::optional<evaluation::LoopTruth> truth_;
};

loop::Vocabulary make_vocabulary(const LoopsOptions& options, Places& places,
                                 LoopsOutcome& outcome) {
  if (!options.vocabulary.empty()) {
    outcome.vocabulary = options.vocabulary;
    return loop::load_vocabulary(options.vocabulary);
  }
  cv::Mat all;
  std::vector<std::size_t> ends;
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (!places[i].descriptors.empty()) all.push_back(places[i].descriptors);
    ends.push_back(static_cast<std::size_t>(all.rows));
  }
  if (all.rows == 0)
    throw InvalidArgument("loops: the images show no features to learn words from");
  loop::TrainingOptions training;
  // As many levels as give about ten descriptors to a word.
  training.levels = 3;
  for (double words = 1e3; words < all.rows / 10.0 && training.levels < 6; words *= 10.0)
    ++training.levels;
  training.threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  Progress progress("vocabulary", 100);
  training.progress = [&](std::size_t done, std::size_t total) {
    progress.update(100 * done / std::max<std::size_t>(total, 1));
  };
  outcome.vocabulary = "trained on these images";
  return loop::train_vocabulary(as_view<const std::uint8_t>(all), ends, training);
}

/// Verifies one image against another: with depth by its pose, else by epipolar geometry.
class Verifier {
 public:
  explicit Verifier(Places& places) : places_(places) {
    pose_options_.max_iterations = 500;  // samples of three need few
  }

  loop::Verification operator()(std::uint64_t query, std::uint64_t candidate) {
    const View& q = places_[query];
    const View& c = places_[candidate];
    loop::match_by_nodes(q.direct, as_view<const std::uint8_t>(q.descriptors), c.direct,
                         as_view<const std::uint8_t>(c.descriptors), {}, matches_);
    const auto n = static_cast<Eigen::Index>(matches_.size());
    Eigen::Matrix2Xd query_pixels(2, n), candidate_pixels(2, n);
    Eigen::Matrix3Xd candidate_points(3, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const Match& match = matches_[static_cast<std::size_t>(i)];
      const cv::Point2f p = q.keypoints[static_cast<std::size_t>(match.query)].pt;
      const cv::Point2f r = c.keypoints[static_cast<std::size_t>(match.train)].pt;
      query_pixels.col(i) << p.x, p.y;
      candidate_pixels.col(i) << r.x, r.y;
      if (places_.has_depth()) candidate_points.col(i) = c.points.col(match.train);
    }
    if (places_.has_depth()) {
      loop::Verification found =
          loop::verify_pose(candidate_points, query_pixels, places_.camera(), pose_options_);
      loop::check_depth(as_view<const float>(q.depth), as_view<const float>(c.depth),
                        places_.camera(), places_.camera(), found);
      return found;
    }
    return loop::verify_epipolar(query_pixels, candidate_pixels, std::max(q.width, c.width),
                                 std::max(q.height, c.height));
  }

 private:
  Places& places_;
  loop::RansacOptions pose_options_;
  std::vector<Match> matches_;
};

loop::LoopDetectorOptions detector_options(const LoopsOptions& options, const Places& places) {
  loop::LoopDetectorOptions result;
  result.exclude_recent = places.has_depth() ? 0 : options.exclude_recent;
  return result;
}

void write_line(std::ostream& out, const loop::LoopResult& result) {
  out << result.query << ' ' << loop::to_string(result.reason) << ' '
      << (result.has_match ? static_cast<long long>(result.match) : -1) << ' ' << result.best_score
      << ' ' << result.normalizer << ' ' << result.best_normalized << ' '
      << (result.islands.empty() ? 0 : result.islands.front().consistent) << ' '
      << result.verification.matches << ' ' << result.verification.inliers << ' '
      << result.verification.confidence << '\n';
}

}  // namespace

LoopsOutcome run_loops(const LoopsOptions& options) {
  LoopsOutcome outcome;
  std::ofstream lines;
  if (!options.detections.empty()) {
    lines.open(options.detections);
    if (!lines) throw_io_error(options.detections, "cannot be written");
    lines << "# query reason match score normalizer normalized consistent matches inliers "
             "confidence\n";
  }
  Places places(options, outcome);
  const loop::Vocabulary vocabulary = make_vocabulary(options, places, outcome);
  outcome.words = vocabulary.words();
  // Matching wants few large nodes: the hundred or so of the second level, as in ORB-SLAM.
  const int levels_up = std::max(0, vocabulary.levels() - 2);

  loop::LoopDetector detector(loop::Database(vocabulary.words(), vocabulary.scoring()),
                              detector_options(options, places));
  Verifier verifier(places);
  const loop::VerifyLoop verify =
      options.no_geometry ? loop::VerifyLoop() : loop::VerifyLoop(std::ref(verifier));
  loop::TransformWorkspace workspace;
  std::vector<evaluation::LoopDetection> detections;
  Progress progress("loops", places.size());
  for (std::size_t q = 0; q < places.size(); ++q) {
    const std::vector<std::uint64_t> covisible = places.covisible(q);
    View& view = places[q];
    const auto start = Clock::now();
    loop::Features features;
    features.descriptors = as_view<const std::uint8_t>(view.descriptors);
    vocabulary.transform(features, view.bow, &view.direct, levels_up, workspace);
    loop::LoopQuery query;
    query.id = q;
    query.bow = &view.bow;
    query.covisible = covisible;
    const loop::LoopResult result = detector.detect(query, verify);
    detector.add(q, view.bow);
    outcome.ms.push_back(since(start));
    ++outcome.reasons[static_cast<std::size_t>(result.reason)];
    if (lines) write_line(lines, result);
    progress.update(q + 1);
    if (!result) continue;
    evaluation::LoopDetection detection;
    detection.query = static_cast<int>(q);
    detection.match = static_cast<int>(result.match);
    detection.score = verify ? result.verification.confidence : result.best_normalized;
    detections.push_back(detection);
    if (verify && places.has_depth()) outcome.pose_errors.push_back(places.pose_error(result));
  }
  if (lines.is_open() && !lines.flush()) throw_io_error(options.detections, "cannot be written");
  outcome.scores = places.score(detections);
  outcome.unjudged = detections.size() - outcome.scores.detected;
  return outcome;
}

}  // namespace dynslam::cli
