#include "mover_detector.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include <opencv2/imgproc.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/geometry/mask_evidence.hpp"

#include "depth_alignment.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kReferences = 5;       // P-Static
constexpr std::size_t kMostRemembered = 24;  // frames
constexpr double kShortestGap = 0.05;        // seconds between remembered frames
constexpr float kLeastTrust = 0.05F;         // in what does not move as far as is known
constexpr double kLikely = 0.15;             // log-odds from which users are told that it moves
constexpr double kMostOfIt = 0.9;            // share of a region known to move that tells of it all
constexpr double kKnown = 0.7;               // share of a region's cells that have to be known
constexpr double kDoubt = 0.1;               // weight of no evidence: all is shown to users
constexpr double kOneSurface = 0.015;        // share of depth: a step beyond is a contour to users
constexpr int kSmallest = 2;                 // cells: movers are seen through gaps, too
constexpr int kCoarseness = 4;               // strides of the fine grid between coarse samples
constexpr int kQuarter = 2;                  // and between the cells whose looks tracking asks
constexpr double kLooks = 1.5;               // most log-odds that one reference's looks add there
constexpr float kRememberedLooks = 0.1F;     // share of it that later frames hear of

// Every kQuarter-th cell of a row and column.
void sample_quarter(const geometry::DepthEvidence& all, geometry::DepthEvidence& quarter) {
  quarter.stride = kQuarter * all.stride;
  quarter.focal = all.focal;
  quarter.width = (all.width + kQuarter - 1) / kQuarter;
  quarter.height = (all.height + kQuarter - 1) / kQuarter;
  quarter.depth.clear();
  quarter.log_odds.clear();
  for (int y = 0; y < all.height; y += kQuarter) {
    for (int x = 0; x < all.width; x += kQuarter) {
      const auto i = static_cast<std::size_t>(y * all.width + x);
      quarter.depth.push_back(all.depth[i]);
      quarter.log_odds.push_back(all.log_odds[i]);
    }
  }
}

// Leaves in a quarter of the cells what they have learnt since they were sampled.
void keep_what_is_new(const geometry::DepthEvidence& all, geometry::DepthEvidence& quarter) {
  std::size_t k = 0;
  for (int y = 0; y < all.height; y += kQuarter) {
    for (int x = 0; x < all.width; x += kQuarter) {
      quarter.log_odds[k++] -= all.log_odds[static_cast<std::size_t>(y * all.width + x)];
    }
  }
}

// Adds what a quarter of the cells have learnt, `times` over, to all that have depth.
void spread_quarter(const geometry::DepthEvidence& quarter, float times,
                    geometry::DepthEvidence& all) {
  for (int y = 0; y < all.height; ++y) {
    for (int x = 0; x < all.width; ++x) {
      const auto i = static_cast<std::size_t>(y * all.width + x);
      const auto k = static_cast<std::size_t>(y / kQuarter * quarter.width + x / kQuarter);
      if (all.depth[i] > 0.0F) all.log_odds[i] += times * quarter.log_odds[k];
    }
  }
}

cv::Mat quarter_of(const cv::Mat& gray) {
  cv::Mat quarter;
  if (gray.empty()) return quarter;
  const cv::Size size = gray.size() / kQuarter;  // of whole ones
  cv::resize(gray(cv::Rect({}, size * kQuarter)), quarter, size, 0, 0, cv::INTER_AREA);
  return quarter;
}

}  // namespace

MoverDetector::MoverDetector(const DepthCamera& camera) : camera_(camera) {
  consistency_options_.stride = kSurfaceCell;
  quarter_options_.evidence = kLooks;
  grow_options_.completion = 0.0;
}

void MoverDetector::clear() {
  references_.clear();
  memory_.clear();
  mask_.release();
}

void MoverDetector::choose_references(const RigidTransform& T_cam_world, double timestamp) {
  std::vector<geometry::ReferenceCandidate> candidates;
  for (std::size_t i = 0; i < references_.size(); ++i) {
    candidates.push_back(
        {i, references_[i].timestamp, T_cam_world * references_[i].T_cam_world.inverse()});
  }
  std::array<int, kReferences> chosen{};
  const std::size_t count =
      geometry::choose_depth_references(camera_, timestamp, candidates, choice_options_, chosen);
  chosen_.clear();
  chosen_gray_.clear();
  chosen_quarters_.clear();
  for (std::size_t i = 0; i < count; ++i) {
    const auto index = static_cast<std::size_t>(chosen[i]);
    chosen_.push_back({candidates[index].T_cur_ref, &references_[index].cells,
                       timestamp - references_[index].timestamp});
    chosen_gray_.push_back(as_view<const std::uint8_t>(references_[index].gray_cells));
    chosen_quarters_.push_back(as_view<const std::uint8_t>(references_[index].gray_quarter));
  }
}

double MoverDetector::static_share(const cv::Mat& depth, const RigidTransform& T_cam_world,
                                   double timestamp) {
  choose_references(T_cam_world, timestamp);
  geometry::DepthConsistencyOptions options = consistency_options_;
  options.stride *= kCoarseness;
  geometry::judge_depth(as_view<const float>(depth), camera_, chosen_, options, coarse_);
  return coarse_.static_share();
}

void MoverDetector::detect(const TrackedFrame& frame,
                           Span<const geometry::FeatureVerdict> verdicts) {
  const auto view = as_view<const float>(frame.depth);
  const double timestamp = frame.timestamp;
  const RigidTransform& T_cam_world = frame.T_cam_world;
  choose_references(T_cam_world, timestamp);
  geometry::judge_depth(view, camera_, chosen_, consistency_options_, evidence_);
  const bool masked = !frame.mask.empty();
  if (masked) {
    look_at_quarter(frame);
    spread_quarter(quarter_, kRememberedLooks, evidence_);
  }
  memory_.update(camera_, T_cam_world.inverse(), timestamp, consistency_options_.decision,
                 evidence_);
  if (masked) spread_quarter(quarter_, 1.0F - kRememberedLooks, evidence_);
  mask_.create(frame.depth.size(), CV_8UC1);
  masked_share_ = geometry::grow_regions(
      view, evidence_, field(frame.features->keypoints, &cv::KeyPoint::pt), verdicts, grow_options_,
      workspace_, as_view<std::uint8_t>(mask_), as_view<const std::uint8_t>(frame.gray));
}

// Without masks of people it would do harm: cloth that folds looks new wherever it is, and what
// looks ask for is a pose that no walker has captured.
void MoverDetector::look_at_quarter(const TrackedFrame& frame) {
  const cv::Mat gray = quarter_of(frame.gray_cells);
  sample_quarter(evidence_, quarter_);
  geometry::add_appearance(camera_, as_view<const std::uint8_t>(gray), chosen_, chosen_quarters_,
                           consistency_options_, quarter_options_, looks_, quarter_);
  keep_what_is_new(evidence_, quarter_);
}

// What a mask hides was seen before as well: networks take furniture for people.
void MoverDetector::add_hidden(const TrackedFrame& frame) {
  hidden_depth_.create(frame.depth.size(), CV_32FC1);
  hidden_depth_.setTo(0.0F);
  frame.hidden_depth.copyTo(hidden_depth_, frame.mask);
  geometry::judge_depth(as_view<const float>(hidden_depth_), camera_, chosen_, consistency_options_,
                        hidden_);
  for (std::size_t i = 0; i < whole_.log_odds.size(); ++i) {
    whole_.log_odds[i] += hidden_.log_odds[i];
  }
  cv::max(frame.depth, hidden_depth_, whole_depth_);
  geometry::add_mask(as_view<const float>(whole_depth_), as_view<const std::uint8_t>(frame.mask),
                     {}, whole_);
}

// Depth cannot tell a surface that slides within itself from one that stands still.
void MoverDetector::add_looks(const TrackedFrame& frame) {
  geometry::add_appearance(camera_, as_view<const std::uint8_t>(frame.gray_cells), chosen_,
                           chosen_gray_, consistency_options_, {}, looks_, whole_);
}

const cv::Mat& MoverDetector::complete(const TrackedFrame& frame,
                                       Span<const geometry::FeatureVerdict> verdicts) {
  geometry::RegionGrowOptions options = grow_options_;
  options.completion = geometry::RegionGrowOptions().completion;
  options.min_cells = kSmallest;
  options.decision = kLikely;
  options.fill_share = kMostOfIt;
  options.known_share = kKnown;
  options.doubt = kDoubt;
  options.jump = kOneSurface;
  const bool masked = !frame.mask.empty();
  choose_references(frame.T_cam_world, frame.timestamp);
  whole_ = evidence_;
  if (masked) {
    spread_quarter(quarter_, -1.0F, whole_);  // all cells are asked below
    add_hidden(frame);
  }
  add_looks(frame);
  const auto depth = as_view<const float>(masked ? whole_depth_ : frame.depth);
  completed_.create(frame.depth.size(), CV_8UC1);
  geometry::grow_regions(depth, whole_, field(frame.features->keypoints, &cv::KeyPoint::pt),
                         verdicts, options, workspace_, as_view<std::uint8_t>(completed_),
                         as_view<const std::uint8_t>(frame.gray));
  return completed_;
}

void MoverDetector::remember(const TrackedFrame& frame) {
  if (!references_.empty() && frame.timestamp - references_.back().timestamp < kShortestGap) return;
  Reference reference{frame.timestamp,
                      frame.T_cam_world,
                      {},
                      frame.gray_cells,
                      frame.mask.empty() ? cv::Mat() : quarter_of(frame.gray_cells)};
  geometry::build_depth_cells(as_view<const float>(frame.depth), camera_,
                              as_view<const std::uint8_t>(mask_), cells_options_, reference.cells);
  references_.push_back(std::move(reference));
  if (references_.size() > kMostRemembered) thin_out();
}

// Drops the frame whose neighbours in time stand in for it best: the older, the sparser.
void MoverDetector::thin_out() {
  const double now = references_.back().timestamp + kShortestGap;
  std::size_t least = 1;
  double least_gap = std::numeric_limits<double>::infinity();
  for (std::size_t i = 1; i + 1 < references_.size(); ++i) {
    const double gap =
        std::log((now - references_[i - 1].timestamp) / (now - references_[i + 1].timestamp));
    if (gap < least_gap) {
      least_gap = gap;
      least = i;
    }
  }
  references_.erase(references_.begin() + static_cast<std::ptrdiff_t>(least));
}

cv::Mat MoverDetector::trust() const {
  cv::Mat trust(evidence_.height, evidence_.width, CV_32FC1);
  for (int y = 0; y < trust.rows; ++y) {
    const std::uint8_t* mask = mask_.ptr(y * evidence_.stride + evidence_.stride / 2);
    const float* odds = &evidence_.log_odds[static_cast<std::size_t>(y * evidence_.width)];
    float* row = trust.ptr<float>(y);
    for (int x = 0; x < trust.cols; ++x) {
      const bool moves = mask[x * evidence_.stride + evidence_.stride / 2] != 0;
      const float known = odds[x] < 0.0F ? std::tanh(-0.5F * odds[x]) : 0.0F;
      row[x] = moves ? 0.0F : std::max(kLeastTrust, known);
    }
  }
  return trust;
}

cv::Mat MoverDetector::judged() const {
  if (mask_.empty()) return {};
  cv::Mat cells(evidence_.height, evidence_.width, CV_8UC1), judged;
  std::transform(evidence_.verdict.begin(), evidence_.verdict.end(), cells.begin<std::uint8_t>(),
                 [](geometry::Verdict v) { return v == geometry::Verdict::kUnknown ? 0 : 255; });
  cv::resize(cells, judged, mask_.size(), 0, 0, cv::INTER_NEAREST);
  return judged;
}

float MoverDetector::staticness(cv::Point2f pixel) const {
  if (mask_.empty() || evidence_.width == 0) return 0.5F;
  const int x = std::clamp(static_cast<int>(pixel.x) / evidence_.stride, 0, evidence_.width - 1);
  const int y = std::clamp(static_cast<int>(pixel.y) / evidence_.stride, 0, evidence_.height - 1);
  const float odds = evidence_.log_odds[static_cast<std::size_t>(y * evidence_.width + x)];
  return 1.0F / (1.0F + std::exp(odds));
}

void MoverDetector::move_world(const RigidTransform& T_before_after) {
  for (Reference& reference : references_)
    reference.T_cam_world = reference.T_cam_world * T_before_after;
}

void MoverDetector::repose(double after, const std::function<RigidTransform(double)>& pose) {
  for (Reference& reference : references_) {
    if (reference.timestamp > after) reference.T_cam_world = pose(reference.timestamp);
  }
  memory_.clear();
}

}  // namespace dynslam::slam
