#include "wide_alignment.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dynslam/core/so3.hpp"

#include "matrix6.hpp"
#include "median.hpp"

namespace dynslam::slam {
namespace {

constexpr int kStartStep = 6;           // cells, when starts are aligned
constexpr int kFineStep = 2;            // cells, when the best are aligned and compared
constexpr int kSlideStep = 4;           // cells, when outlines are compared
constexpr std::size_t kFinalists = 4;   // starts that are aligned finely
constexpr int kWeakest = 2;             // directions in which outlines are asked
constexpr double kOutlineSigma = 0.01;  // metres, certainty of what outlines say
constexpr double kSurfaceTrust = 0.01;  // neighbouring cells err alike
constexpr double kHard = 1e9;           // information that surfaces do not override
constexpr double kSceneRadius = 0.5;    // of what is seen, over its distance
constexpr double kWeak = 0.1;           // of the surest direction's information
constexpr double kHeld = 0.06;          // metres by which a determined motion cannot be moved
constexpr double kLeastLoss = 0.005;    // of the score, if it is
constexpr double kDegree = 3.14159265358979 / 180.0;
constexpr double kSame = 0.03;               // metres and radians by which motions are one
constexpr float kSimilarBrightness = 20.0F;  // grey levels
constexpr float kOddlyLit = 0.25F;           // worth of a point that agrees in shape alone
constexpr float kAsBright = 8.0F;            // grey levels, of a surface that agrees
constexpr float kFarthest = 5.0F;            // metres beyond which a cell covers no more
constexpr double kLeastScore = 0.5;          // of a fit that is believed

/// Twists, one a column.
using Directions = Eigen::Matrix<double, 6, kWeakest>;

struct Candidate {
  RigidTransform T_from_to;
  double score = 0.0;
  Directions weak = Directions::Zero();  // what surfaces hold least
};

float tolerance(float z) { return 0.012F + 0.006F * z * z; }

// Of a cell, up to a factor that all cells share.
float square_metres(const Eigen::Vector3f& point) {
  const float z = std::min(kFarthest, point.z());
  return z * z;
}

// Brightness between the middles of four cells; u, v in cells.
float brightness(const cv::Mat& gray, float u, float v) {
  const float x = std::clamp(u - 0.5F, 0.0F, static_cast<float>(gray.cols) - 1.001F);
  const float y = std::clamp(v - 0.5F, 0.0F, static_cast<float>(gray.rows) - 1.001F);
  const int column = static_cast<int>(x), row = static_cast<int>(y);
  const float a = x - static_cast<float>(column), b = y - static_cast<float>(row);
  const float* upper = gray.ptr<float>(row) + column;
  const float* lower = gray.ptr<float>(row + 1) + column;
  return (1 - b) * ((1 - a) * upper[0] + a * upper[1]) + b * ((1 - a) * lower[0] + a * lower[1]);
}

/// Counts behind a SurfaceFit.
struct Sightings {
  int points = 0, seen = 0, conflict = 0, behind = 0;
  double surface = 0.0;  // of the points
  struct Partner {
    float closeness;   // 0..1
    float difference;  // in brightness
    float surface;
  };
  std::vector<Partner> partners;

  void add(const SurfaceGrid& a, std::size_t i, const SurfaceGrid& b, float u, float v,
           const Eigen::Vector3f& p);
};

// Point i of `a`, `p` in coordinates of `b`'s camera, falls on (u, v) of b's cells.
void Sightings::add(const SurfaceGrid& a, std::size_t i, const SurfaceGrid& b, float u, float v,
                    const Eigen::Vector3f& p) {
  const auto j = static_cast<std::size_t>(static_cast<int>(v) * b.width + static_cast<int>(u));
  if (b.points[j].z() == 0.0F) return;
  ++seen;
  const Eigen::Vector3f gap = p - b.points[j];
  const float limit = tolerance(p.z());
  // Along the normal where there is one: on slanted surfaces depth changes within a cell.
  const float off = b.normals[j].isZero() ? gap.z() : b.normals[j].dot(gap);
  if (std::abs(off) < limit && gap.squaredNorm() < 25.0F * limit * limit) {
    const bool lit = !a.gray.empty() && !b.gray.empty();
    const float r = off / limit;
    partners.push_back({1.0F - r * r,
                        lit ? a.gray.ptr<float>()[i] - brightness(b.gray, u, v) : 0.0F,
                        square_metres(a.points[i])});
  } else if (gap.z() < -2.0F * limit) {
    ++conflict;
  } else if (gap.z() > 2.0F * limit) {
    ++behind;
  }
}

// What the camera of `b` says of every `step`-th point of `a`.
void look(const SurfaceGrid& a, const SurfaceGrid& b, const PinholeCamera& camera,
          const RigidTransform& T_b_a, int step, Sightings& sightings) {
  const Eigen::Matrix3f R = T_b_a.R.cast<float>();
  const Eigen::Vector3f t = T_b_a.t.cast<float>();
  const auto fx = static_cast<float>(camera.fx), fy = static_cast<float>(camera.fy);
  const auto cx = static_cast<float>(camera.cx), cy = static_cast<float>(camera.cy);
  for (int row = step / 2; row < a.height; row += step) {
    for (int column = step / 2; column < a.width; column += step) {
      const auto i = static_cast<std::size_t>(row * a.width + column);
      if (a.points[i].z() == 0.0F) continue;
      ++sightings.points;
      sightings.surface += square_metres(a.points[i]);
      const Eigen::Vector3f p = R * a.points[i] + t;
      if (p.z() <= static_cast<float>(kMinDepth)) continue;
      const float u = (fx * p.x() / p.z() + cx + 0.5F) / kSurfaceCell;
      const float v = (fy * p.y() / p.z() + cy + 0.5F) / kSurfaceCell;
      if (!(u >= 0.0F && v >= 0.0F)) continue;
      if (u < static_cast<float>(b.width) && v < static_cast<float>(b.height)) {
        sightings.add(a, i, b, u, v, p);
      }
    }
  }
}

// Worth of the partners: whole if they are as bright as the change of exposure lets expect.
double worth(const Sightings& sightings, float exposure) {
  double sum = 0.0;
  for (const auto& partner : sightings.partners) {
    const bool alike = std::abs(partner.difference - exposure) < kSimilarBrightness;
    sum += partner.closeness * (alike ? 1.0F : kOddlyLit);
  }
  return sum;
}

// How much brighter the first camera saw what both see.
float exposure_of(const Sightings& sightings) {
  std::vector<float> differences;
  for (const auto& partner : sightings.partners) differences.push_back(partner.difference);
  return differences.empty() ? 0.0F : median(differences);
}

double agreeing_surface(const Sightings& sightings, float exposure) {
  double sum = 0.0;
  for (const auto& partner : sightings.partners) {
    if (std::abs(partner.difference - exposure) >= kAsBright) continue;
    // As closeness, of half the tolerance.
    sum += partner.surface * std::max(0.0F, 4.0F * partner.closeness - 3.0F);
  }
  return sum;
}

double middle_distance(const SurfaceGrid& grid) {
  std::vector<float> depths;
  for (std::size_t i = 0; i < grid.points.size(); i += 16) {
    if (grid.points[i].z() > 0.0F) depths.push_back(grid.points[i].z());
  }
  return depths.empty() ? 1.0 : median(depths);
}

// Turns of the camera on the spot, and around what it looks at.
void add_rotations(double distance, std::vector<RigidTransform>& starts) {
  const Eigen::Vector3d centre(0.0, 0.0, distance);
  for (const double yaw : {-24.0, -12.0, 0.0, 12.0, 24.0}) {
    for (const double pitch : {-12.0, 0.0, 12.0}) {
      if (yaw == 0.0 && pitch == 0.0) continue;
      const Eigen::Matrix3d R = so3_exp(Eigen::Vector3d(pitch, yaw, 0.0) * kDegree);
      starts.emplace_back(R, Eigen::Vector3d::Zero());
      starts.emplace_back(R, centre - R * centre);
    }
  }
}

AlignmentOptions loose_options(int step) {
  AlignmentOptions options;
  options.step = step;
  options.last_gate = 0.12;
  options.min_overlap = 0.2;
  options.max_rms = 0.1;
  // Enough to keep a direction that the surfaces leave open where it was.
  options.guess_information = Matrix6d::Identity();
  return options;
}

bool same(const RigidTransform& a, const RigidTransform& b) {
  return se3_log(a * b.inverse()).cwiseAbs().maxCoeff() < kSame;
}

void sort_distinct(std::vector<Candidate>& candidates, std::size_t most) {
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  std::vector<Candidate> kept;
  for (const Candidate& candidate : candidates) {
    const bool known = std::any_of(kept.begin(), kept.end(), [&](const Candidate& k) {
      return same(k.T_from_to, candidate.T_from_to);
    });
    if (!known && kept.size() < most) kept.push_back(candidate);
  }
  candidates = std::move(kept);
}

/// What surfaces know of a motion, by directions about the middle of the scene.
class SceneMotions {
 public:
  SceneMotions(const Matrix6d& information, double distance) {
    const Eigen::Vector3d centre(0.0, 0.0, distance);
    const double radius = kSceneRadius * distance;
    about_scene_ = Matrix6d::Identity();
    about_scene_.topRightCorner<3, 3>() = skew(centre) / radius;
    about_scene_.bottomRightCorner<3, 3>() /= radius;
    eigen_ = eigen_of(about_scene_.transpose() * information * about_scene_);
  }

  /// Twists of the camera that move what is seen by about a metre; zero where surfaces are sure.
  Directions weak() const {
    Directions weak = Directions::Zero();
    for (int k = 0; k < kWeakest && is_weak(k); ++k) {
      weak.col(k) = about_scene_ * eigen_.vectors.col(k);
    }
    return weak;
  }

  /// The information, with that along weak directions set to `weak_information`.
  Matrix6d information(double weak_information) const {
    Vector6d values = eigen_.values;
    for (int k = 0; k < kWeakest && is_weak(k); ++k) values[k] = weak_information;
    const Matrix6d back = eigen_.vectors.transpose() * inverse_of(about_scene_);
    return back.transpose() * values.asDiagonal() * back;
  }

 private:
  bool is_weak(int k) const { return eigen_.values[k] < kWeak * eigen_.values[5]; }

  Matrix6d about_scene_;
  Eigen6 eigen_;
};

class Search {
 public:
  Search(const SurfaceGrid& from, const SurfaceGrid& to, const PinholeCamera& camera)
      : from_(from), to_(to), camera_(camera), distance_(middle_distance(to)) {}

  double distance() const { return distance_; }
  double score(const RigidTransform& T_from_to, int step) const {
    return measure_fit(from_, to_, camera_, T_from_to, step).score();
  }
  void start(const RigidTransform& guess, bool worth_keeping, std::vector<Candidate>& found) const;
  void refine(Candidate& candidate) const;
  std::optional<SurfaceAlignment> finish(const Candidate& candidate) const;

 private:
  void slide(Candidate& candidate) const;
  bool holds(const Candidate& candidate) const;

  const SurfaceGrid& from_;
  const SurfaceGrid& to_;
  const PinholeCamera& camera_;
  double distance_;
};

void Search::start(const RigidTransform& guess, bool worth_keeping,
                   std::vector<Candidate>& found) const {
  // What features say may be better than what coarse surfaces make of it.
  if (worth_keeping) found.push_back({guess, score(guess, kStartStep), Directions::Zero()});
  const auto coarse = align_surfaces(from_, to_, camera_, guess, loose_options(kStartStep));
  if (!coarse) return;
  const RigidTransform& T_from_to = coarse->T_from_to;
  found.push_back({T_from_to, score(T_from_to, kStartStep), Directions::Zero()});
}

// Surfaces can slide along themselves; their outlines cannot without being in conflict.
void Search::slide(Candidate& candidate) const {
  for (double length = 0.16; length > 0.004; length *= 0.5) {
    const RigidTransform centre = candidate.T_from_to;
    for (int k = 0; k < kWeakest; ++k) {
      if (candidate.weak.col(k).isZero()) break;
      for (const double sign : {-1.0, 1.0}) {
        const RigidTransform moved = se3_exp(sign * length * candidate.weak.col(k)) * centre;
        const double moved_score = score(moved, kSlideStep);
        if (moved_score <= candidate.score) continue;
        candidate.T_from_to = moved;
        candidate.score = moved_score;
      }
    }
  }
}

// Surfaces and outlines in turns: each moves what the other knows little of.
void Search::refine(Candidate& candidate) const {
  AlignmentOptions options = loose_options(kFineStep);
  options.first_gate = 0.12;
  options.last_gate = 0.05;
  for (int round = 0; round < 2; ++round) {
    const auto fine = align_surfaces(from_, to_, camera_, candidate.T_from_to, options);
    if (!fine) return;
    candidate.T_from_to = fine->T_from_to;
    candidate.score = score(fine->T_from_to, kSlideStep);
    if (round == 0) candidate.weak = SceneMotions(fine->information, distance_).weak();
    slide(candidate);
    options.first_gate = 0.05;
    options.guess_information =
        kHard * candidate.weak * candidate.weak.transpose() + Matrix6d::Identity();
  }
  candidate.score = score(candidate.T_from_to, kFineStep);
}

// Whether the fit gets worse either way along each weak direction.
bool Search::holds(const Candidate& candidate) const {
  for (int k = 0; k < kWeakest; ++k) {
    if (candidate.weak.col(k).isZero()) break;
    for (const double length : {-kHeld, kHeld}) {
      const RigidTransform moved = se3_exp(length * candidate.weak.col(k)) * candidate.T_from_to;
      if (score(moved, kFineStep) > candidate.score - kLeastLoss) return false;
    }
  }
  return true;
}

std::optional<SurfaceAlignment> Search::finish(const Candidate& candidate) const {
  if (candidate.score < kLeastScore || !holds(candidate)) return std::nullopt;
  AlignmentOptions options;
  options.first_gate = 0.05;
  options.guess_information =
      kHard * candidate.weak * candidate.weak.transpose() + Matrix6d::Identity();
  auto alignment = align_surfaces(from_, to_, camera_, candidate.T_from_to, options);
  if (!alignment) return std::nullopt;
  alignment->information = SceneMotions(alignment->information, distance_)
                               .information(1.0 / (kSurfaceTrust * kOutlineSigma * kOutlineSigma));
  return alignment;
}

}  // namespace

SurfaceFit measure_fit(const SurfaceGrid& from, const SurfaceGrid& to, const PinholeCamera& camera,
                       const RigidTransform& T_from_to, int step) {
  Sightings there, back;
  look(to, from, camera, T_from_to, step, there);
  look(from, to, camera, T_from_to.inverse(), step, back);
  SurfaceFit fit;
  const int points = there.points + back.points;
  if (points == 0) return fit;
  const float exposure = exposure_of(there);
  fit.agree = (worth(there, exposure) + worth(back, -exposure)) / points;
  fit.conflict = static_cast<double>(there.conflict + back.conflict) / points;
  fit.behind = static_cast<double>(there.behind + back.behind) / points;
  fit.seen = static_cast<double>(there.seen + back.seen) / points;
  return fit;
}

double agreeing_surface(const SurfaceGrid& from, const SurfaceGrid& to, const PinholeCamera& camera,
                        const RigidTransform& T_from_to, int step) {
  Sightings there, back;
  look(to, from, camera, T_from_to, step, there);
  look(from, to, camera, T_from_to.inverse(), step, back);
  const double all = there.surface + back.surface;
  if (all == 0.0) return 0.0;
  const float exposure = exposure_of(there);
  return (agreeing_surface(there, exposure) + agreeing_surface(back, -exposure)) / all;
}

cv::Mat surface_by_cell(const SurfaceGrid& grid) {
  cv::Mat surface(grid.height, grid.width, CV_32FC1);
  std::transform(grid.points.begin(), grid.points.end(), surface.begin<float>(), square_metres);
  return surface;
}

std::optional<WideAlignment> align_wide(const SurfaceGrid& from, const SurfaceGrid& to,
                                        const PinholeCamera& camera,
                                        Span<const RigidTransform> guesses) {
  if (from.empty() || to.empty()) return std::nullopt;
  const Search search(from, to, camera);
  std::vector<RigidTransform> starts(guesses.begin(), guesses.end());
  add_rotations(search.distance(), starts);
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < starts.size(); ++i) {
    search.start(starts[i], i < guesses.size(), candidates);
  }
  sort_distinct(candidates, kFinalists);
  for (Candidate& candidate : candidates) search.refine(candidate);
  sort_distinct(candidates, 1);
  if (candidates.empty()) return std::nullopt;
  const auto alignment = search.finish(candidates.front());
  if (!alignment) return std::nullopt;
  return WideAlignment{*alignment, measure_fit(from, to, camera, alignment->T_from_to, kFineStep)};
}

}  // namespace dynslam::slam
