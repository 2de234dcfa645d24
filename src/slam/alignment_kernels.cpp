#include "slam/alignment_kernels.hpp"

#include "slam/alignment_views.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "slam/alignment_kernels.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::slam::kernels {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<float, 16>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;
using VI = hn::Vec<DI>;
using M = hn::Mask<D>;

struct V3 {
  V x, y, z;
};

HWY_INLINE V dot(const V3& a, const V3& b) {
  return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}

HWY_INLINE V3 cross(const V3& a, const V3& b) {
  return {hn::MulSub(a.y, b.z, hn::Mul(a.z, b.y)), hn::MulSub(a.z, b.x, hn::Mul(a.x, b.z)),
          hn::MulSub(a.x, b.y, hn::Mul(a.y, b.x))};
}

HWY_INLINE V3 rotate(D d, const float* R, const V3& a) {
  const auto row = [&](int k) HWY_ATTR {
    return dot({hn::Set(d, R[3 * k]), hn::Set(d, R[3 * k + 1]), hn::Set(d, R[3 * k + 2])}, a);
  };
  return {row(0), row(1), row(2)};
}

HWY_INLINE V3 gather(D d, const float* HWY_RESTRICT values, VI cell) {
  const VI first = hn::Add(hn::Add(cell, cell), cell);
  return {hn::GatherIndex(d, values, first), hn::GatherIndex(d, values + 1, first),
          hn::GatherIndex(d, values + 2, first)};
}

HWY_INLINE M has_normal(D d, const V3& normal) {
  return hn::Gt(dot(normal, normal), hn::Set(d, 0.5F));
}

/// Residuals until they are added up. Where a cell has no partner, weights are 0 and all is finite.
struct Stage {
  static constexpr std::size_t kCapacity = 512;
  HWY_ALIGN float J[6][kCapacity];
  HWY_ALIGN float r[kCapacity];
  HWY_ALIGN float weight[kCapacity];
  std::size_t size = 0;
};

/// Sums that a residual adds to besides H and g.
struct Tally {
  V squares, chi2, trust;
};

HWY_INLINE void push(D d, const V3& d_position, const V3& d_rotation, V r, V inverse_sigma, V trust,
                     const Matching& matching, Stage& stage, Tally& tally) {
  const V whitened = hn::Abs(hn::Mul(r, inverse_sigma));
  const V huber = hn::Div(hn::Set(d, kHuber), hn::Max(whitened, hn::Set(d, kHuber)));
  const V clipped = hn::Min(hn::Mul(whitened, whitened), hn::Set(d, matching.max_chi2));
  tally.chi2 = hn::MulAdd(trust, clipped, tally.chi2);
  tally.trust = hn::Add(tally.trust, trust);
  const std::size_t at = stage.size;
  hn::Store(d_position.x, d, stage.J[0] + at);
  hn::Store(d_position.y, d, stage.J[1] + at);
  hn::Store(d_position.z, d, stage.J[2] + at);
  hn::Store(d_rotation.x, d, stage.J[3] + at);
  hn::Store(d_rotation.y, d, stage.J[4] + at);
  hn::Store(d_rotation.z, d, stage.J[5] + at);
  hn::Store(r, d, stage.r + at);
  hn::Store(hn::Mul(hn::Mul(trust, huber), hn::Mul(inverse_sigma, inverse_sigma)), d,
            stage.weight + at);
  stage.size += hn::Lanes(d);
}

HWY_INLINE double total(D d, V v) { return hn::GetLane(hn::SumOfLanes(d, v)); }

// Adds what is staged to the sums.
void flush(Stage& stage, AlignmentSums& sums) {
  const D d;
  const V zero = hn::Zero(d);
  V h00 = zero, h01 = zero, h02 = zero, h03 = zero, h04 = zero, h05 = zero, h11 = zero;
  V h12 = zero, h13 = zero, h14 = zero, h15 = zero, h22 = zero, h23 = zero, h24 = zero;
  V h25 = zero, h33 = zero, h34 = zero, h35 = zero, h44 = zero, h45 = zero, h55 = zero;
  V g0 = zero, g1 = zero, g2 = zero, g3 = zero, g4 = zero, g5 = zero;
  for (std::size_t i = 0; i < stage.size; i += hn::Lanes(d)) {
    const V w = hn::Load(d, stage.weight + i), r = hn::Load(d, stage.r + i);
    const V j0 = hn::Load(d, stage.J[0] + i), j1 = hn::Load(d, stage.J[1] + i);
    const V j2 = hn::Load(d, stage.J[2] + i), j3 = hn::Load(d, stage.J[3] + i);
    const V j4 = hn::Load(d, stage.J[4] + i), j5 = hn::Load(d, stage.J[5] + i);
    V wj = hn::Mul(w, j0);
    h00 = hn::MulAdd(wj, j0, h00), h01 = hn::MulAdd(wj, j1, h01), h02 = hn::MulAdd(wj, j2, h02);
    h03 = hn::MulAdd(wj, j3, h03), h04 = hn::MulAdd(wj, j4, h04), h05 = hn::MulAdd(wj, j5, h05);
    g0 = hn::MulAdd(wj, r, g0);
    wj = hn::Mul(w, j1);
    h11 = hn::MulAdd(wj, j1, h11), h12 = hn::MulAdd(wj, j2, h12), h13 = hn::MulAdd(wj, j3, h13);
    h14 = hn::MulAdd(wj, j4, h14), h15 = hn::MulAdd(wj, j5, h15), g1 = hn::MulAdd(wj, r, g1);
    wj = hn::Mul(w, j2);
    h22 = hn::MulAdd(wj, j2, h22), h23 = hn::MulAdd(wj, j3, h23), h24 = hn::MulAdd(wj, j4, h24);
    h25 = hn::MulAdd(wj, j5, h25), g2 = hn::MulAdd(wj, r, g2);
    wj = hn::Mul(w, j3);
    h33 = hn::MulAdd(wj, j3, h33), h34 = hn::MulAdd(wj, j4, h34), h35 = hn::MulAdd(wj, j5, h35);
    g3 = hn::MulAdd(wj, r, g3);
    wj = hn::Mul(w, j4);
    h44 = hn::MulAdd(wj, j4, h44), h45 = hn::MulAdd(wj, j5, h45), g4 = hn::MulAdd(wj, r, g4);
    wj = hn::Mul(w, j5);
    h55 = hn::MulAdd(wj, j5, h55), g5 = hn::MulAdd(wj, r, g5);
  }
  stage.size = 0;
  double* H = sums.H;
  H[0] += total(d, h00), H[1] += total(d, h01), H[2] += total(d, h02), H[3] += total(d, h03);
  H[4] += total(d, h04), H[5] += total(d, h05), H[6] += total(d, h11), H[7] += total(d, h12);
  H[8] += total(d, h13), H[9] += total(d, h14), H[10] += total(d, h15), H[11] += total(d, h22);
  H[12] += total(d, h23), H[13] += total(d, h24), H[14] += total(d, h25), H[15] += total(d, h33);
  H[16] += total(d, h34), H[17] += total(d, h35), H[18] += total(d, h44), H[19] += total(d, h45);
  H[20] += total(d, h55);
  double* g = sums.g;
  g[0] += total(d, g0), g[1] += total(d, g1), g[2] += total(d, g2);
  g[3] += total(d, g3), g[4] += total(d, g4), g[5] += total(d, g5);
}

/// Points of `to` in the camera of `from`, and where they fall.
struct Landing {
  V3 point;
  V inverse_z;
  V u, v;   // pixels; 0 where there is none
  M valid;  // a candidate
};

HWY_INLINE Landing project(D d, const Motion& motion, const Pinhole& camera, const V3& point,
                           M valid) {
  Landing out;
  out.point = rotate(d, motion.R, point);
  out.point.x = hn::Add(out.point.x, hn::Set(d, motion.t[0]));
  out.point.y = hn::Add(out.point.y, hn::Set(d, motion.t[1]));
  out.point.z = hn::Add(out.point.z, hn::Set(d, motion.t[2]));
  const M front = hn::And(valid, hn::Gt(out.point.z, hn::Set(d, static_cast<float>(kMinDepth))));
  out.inverse_z = hn::Div(hn::Set(d, 1.0F), hn::IfThenElse(front, out.point.z, hn::Set(d, 1.0F)));
  const V u =
      hn::MulAdd(hn::Mul(hn::Set(d, camera.fx), out.point.x), out.inverse_z, hn::Set(d, camera.cx));
  const V v =
      hn::MulAdd(hn::Mul(hn::Set(d, camera.fy), out.point.y), out.inverse_z, hn::Set(d, camera.cy));
  const V zero = hn::Zero(d);
  const M right = hn::And(hn::Ge(u, zero), hn::Le(u, hn::Set(d, camera.last_column)));
  const M below = hn::And(hn::Ge(v, zero), hn::Le(v, hn::Set(d, camera.last_row)));
  out.valid = hn::And(front, hn::And(right, below));
  out.u = hn::IfThenElseZero(out.valid, u);
  out.v = hn::IfThenElseZero(out.valid, v);
  return out;
}

// By how much `from` is brighter where a point lands than `to` was there; J by the chain rule.
HWY_INLINE void push_brightness(D d, const Surface& from, V gray, const Pinhole& camera,
                                const Landing& at, V trust, const Matching& matching, Stage& stage,
                                Tally& tally) {
  const DI di;
  const V half = hn::Set(d, 0.5F), one = hn::Set(d, 1.0F);
  const V per_pixel = hn::Set(d, 1.0F / kSurfaceCell);
  // Between the middles of four cells.
  const V x = hn::MulSub(hn::Add(at.u, half), per_pixel, half);
  const V y = hn::MulSub(hn::Add(at.v, half), per_pixel, half);
  const V left = hn::Floor(x), top = hn::Floor(y), zero = hn::Zero(d);
  const M first = hn::And(hn::Ge(left, zero), hn::Ge(top, zero));
  const M last = hn::And(hn::Lt(left, hn::Set(d, static_cast<float>(from.width - 1))),
                         hn::Lt(top, hn::Set(d, static_cast<float>(from.height - 1))));
  const M inside = hn::And(hn::And(first, last), hn::Gt(trust, zero));
  const VI column = hn::ConvertTo(di, hn::IfThenElseZero(inside, left));
  const VI row = hn::ConvertTo(di, hn::IfThenElseZero(inside, top));
  const VI cell = hn::Add(hn::Mul(row, hn::Set(di, from.width)), column);
  const VI below = hn::Add(cell, hn::Set(di, from.width));
  const V v00 = hn::GatherIndex(d, from.gray, cell), v01 = hn::GatherIndex(d, from.gray + 1, cell);
  const V v10 = hn::GatherIndex(d, from.gray, below);
  const V v11 = hn::GatherIndex(d, from.gray + 1, below);
  const V a = hn::Sub(x, left), b = hn::Sub(y, top);
  const V a1 = hn::Sub(one, a), b1 = hn::Sub(one, b);
  const V upper = hn::MulAdd(a, v01, hn::Mul(a1, v00)),
          lower = hn::MulAdd(a, v11, hn::Mul(a1, v10));
  const V value = hn::MulAdd(b, lower, hn::Mul(b1, upper));
  const V slope_x = hn::MulAdd(b, hn::Sub(v11, v10), hn::Mul(b1, hn::Sub(v01, v00)));
  const V slope_y = hn::Sub(lower, upper);
  const V gx = hn::Mul(slope_x, hn::Set(d, camera.fx / kSurfaceCell));
  const V gy = hn::Mul(slope_y, hn::Set(d, camera.fy / kSurfaceCell));
  V3 slope;  // grey levels a metre
  slope.x = hn::Mul(gx, at.inverse_z);
  slope.y = hn::Mul(gy, at.inverse_z);
  const V along = hn::MulAdd(slope.x, at.point.x, hn::Mul(slope.y, at.point.y));
  slope.z = hn::Neg(hn::Mul(along, at.inverse_z));
  const V counts = hn::IfThenElseZero(inside, trust);
  push(d, slope, cross(at.point, slope), hn::Sub(value, gray),
       hn::Set(d, 1.0F / matching.gray_sigma), counts, matching, stage, tally);
}

HWY_INLINE V noise_of(D d, V z) {
  const V off = hn::Sub(z, hn::Set(d, 0.4F));
  const V sigma = hn::MulAdd(hn::Mul(hn::Set(d, 0.0019F), off), off, hn::Set(d, 0.0012F));
  return hn::Max(sigma, hn::Set(d, kLeastNoise));
}

// The cells `to_cell` of `to`, those that are `valid`.
HWY_INLINE void push_cells(D d, const Surface& from, const Surface& to, VI to_cell, M valid,
                           const Motion& motion, const Pinhole& camera, const Matching& matching,
                           Stage& stage, Tally& tally, AlignmentSums& sums) {
  const DI di;
  const V3 to_normal = gather(d, to.normals, to_cell);
  const V3 to_point = gather(d, to.points, to_cell);
  const Landing at = project(d, motion, camera, to_point, hn::And(valid, has_normal(d, to_normal)));
  sums.candidates += static_cast<int>(hn::CountTrue(d, at.valid));
  const V per_pixel = hn::Set(d, 1.0F / kSurfaceCell);
  const VI x = hn::Min(hn::ConvertTo(di, hn::Mul(at.u, per_pixel)), hn::Set(di, from.width - 1));
  const VI y = hn::Min(hn::ConvertTo(di, hn::Mul(at.v, per_pixel)), hn::Set(di, from.height - 1));
  const VI cell = hn::Add(hn::Mul(y, hn::Set(di, from.width)), x);
  const V3 n = gather(d, from.normals, cell), q = gather(d, from.points, cell);
  const V3 gap = {hn::Sub(at.point.x, q.x), hn::Sub(at.point.y, q.y), hn::Sub(at.point.z, q.z)};
  const M near = hn::Le(dot(gap, gap), hn::Set(d, matching.gate * matching.gate));
  const M alike = hn::Ge(dot(n, rotate(d, motion.R, to_normal)), hn::Set(d, matching.min_cosine));
  M met = hn::And(hn::And(at.valid, has_normal(d, n)), hn::And(near, alike));
  V trust = from.trust != nullptr ? hn::GatherIndex(d, from.trust, cell) : hn::Set(d, 1.0F);
  met = hn::And(met, hn::Gt(trust, hn::Zero(d)));
  if (hn::AllFalse(d, met)) return;
  trust = hn::IfThenElseZero(met, trust);
  sums.partners += static_cast<int>(hn::CountTrue(d, met));
  const V r = dot(n, gap);
  tally.squares = hn::Add(tally.squares, hn::IfThenElseZero(met, hn::Mul(r, r)));
  const V inverse_sigma = hn::Div(hn::Set(d, 1.0F), noise_of(d, to_point.z));
  push(d, n, cross(at.point, n), r, inverse_sigma, trust, matching, stage, tally);
  if (matching.gray_sigma > 0.0F) {
    push_brightness(d, from, hn::GatherIndex(d, to.gray, to_cell), camera, at, trust, matching,
                    stage, tally);
  }
}

AlignmentSums sum_partners(const Surface& from, const Surface& to, const Motion& motion,
                           const Pinhole& camera, const Matching& matching) {
  const D d;
  const DI di;
  AlignmentSums sums;
  Stage stage;
  Tally tally{hn::Zero(d), hn::Zero(d), hn::Zero(d)};
  const int lanes = static_cast<int>(hn::Lanes(d));
  const VI offsets = hn::Mul(hn::Iota(di, 0), hn::Set(di, matching.step));
  const VI width = hn::Set(di, to.width);
  for (int row = 0; row < to.height; row += matching.step) {
    for (int column = 0; column < to.width; column += lanes * matching.step) {
      const VI columns = hn::Add(hn::Set(di, column), offsets);
      const auto inside = hn::Lt(columns, width);
      const VI cell = hn::Add(hn::Set(di, row * to.width), hn::IfThenElseZero(inside, columns));
      push_cells(d, from, to, cell, hn::RebindMask(d, inside), motion, camera, matching, stage,
                 tally, sums);
      if (stage.size + 2 * hn::Lanes(d) > Stage::kCapacity) flush(stage, sums);
    }
  }
  flush(stage, sums);
  sums.squares = total(d, tally.squares);
  sums.chi2 = total(d, tally.chi2);
  sums.trust = total(d, tally.trust);
  return sums;
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace dynslam::slam::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::slam::kernels {

HWY_EXPORT(sum_partners);

AlignmentSums sum_partners(const SurfaceGrid& from, const SurfaceGrid& to,
                           const PinholeCamera& camera, const RigidTransform& T_from_to,
                           const Matching& matching) {
  return HWY_DYNAMIC_DISPATCH(sum_partners)(surface_of(from), surface_of(to), motion_of(T_from_to),
                                            pinhole_of(camera), matching);
}

}  // namespace dynslam::slam::kernels
#endif  // HWY_ONCE
