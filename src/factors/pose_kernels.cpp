#include "factors/pose_kernels.hpp"

#include "dynslam/core/camera.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "factors/pose_kernels.cpp"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace dynslam::factors::kernels {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;
using M = hn::Mask<D>;

// A point in camera coordinates, safe to divide by z, and its residuals.
struct Projected {
  V x, y, inv_z;  // x/z, y/z
  V ru, rv, rr;   // measured minus predicted
  M front;
};

HWY_INLINE Projected project(D d, const View& view, const Points& p, std::size_t i) {
  const V X = hn::Load(d, p.x + i), Y = hn::Load(d, p.y + i), Z = hn::Load(d, p.z + i);
  const auto row = [&](int k) HWY_ATTR {
    V a = hn::MulAdd(hn::Set(d, view.R[3 * k]), X, hn::Set(d, view.t[k]));
    a = hn::MulAdd(hn::Set(d, view.R[3 * k + 1]), Y, a);
    return hn::MulAdd(hn::Set(d, view.R[3 * k + 2]), Z, a);
  };
  const V one = hn::Set(d, 1.0);
  const V depth = row(2);
  Projected out;
  out.front = hn::Gt(depth, hn::Set(d, kMinDepth));
  const V safe = hn::IfThenElse(out.front, depth, one);
  out.inv_z = hn::Div(one, safe);
  out.x = hn::IfThenElseZero(out.front, hn::Mul(row(0), out.inv_z));
  out.y = hn::IfThenElseZero(out.front, hn::Mul(row(1), out.inv_z));
  const V u = hn::MulAdd(hn::Set(d, view.fx), out.x, hn::Set(d, view.cx));
  const V v = hn::MulAdd(hn::Set(d, view.fy), out.y, hn::Set(d, view.cy));
  out.ru = hn::Sub(hn::Load(d, p.u + i), u);
  out.rv = hn::Sub(hn::Load(d, p.v + i), v);
  const V right = hn::NegMulAdd(hn::Set(d, view.bf), out.inv_z, u);
  out.rr = hn::Sub(hn::Load(d, p.right + i), right);
  return out;
}

void residuals(const View& view, const Points& p, double* HWY_RESTRICT s) {
  const D d;
  const V behind = hn::Set(d, -1.0);
  for (std::size_t i = 0; i < p.size; i += hn::Lanes(d)) {
    const Projected q = project(d, view, p, i);
    V sum = hn::Mul(q.rv, q.rv);
    sum = hn::MulAdd(q.ru, q.ru, sum);
    sum = hn::Mul(sum, hn::Load(d, p.info + i));
    sum = hn::MulAdd(hn::Mul(q.rr, q.rr), hn::Load(d, p.info_right + i), sum);
    // The bound also catches overflow and NaN: such a point cannot be measured.
    const M valid = hn::And(q.front, hn::Lt(sum, hn::Set(d, 1e30)));
    hn::Store(hn::IfThenElse(valid, sum, behind), d, s + i);
  }
}

HWY_INLINE double total(D d, V v) { return hn::GetLane(hn::SumOfLanes(d, v)); }

void mean_residual(std::size_t size, const double* s, const double* trust, double* sum_out,
                   double* total_out) {
  const D d;
  V sum = hn::Zero(d), count = hn::Zero(d);
  for (std::size_t i = 0; i < size; i += hn::Lanes(d)) {
    const V si = hn::Load(d, s + i);
    const V t = hn::IfThenElseZero(hn::Ge(si, hn::Zero(d)), hn::Load(d, trust + i));
    sum = hn::MulAdd(t, hn::Sqrt(hn::Max(si, hn::Zero(d))), sum);
    count = hn::Add(count, t);
  }
  *sum_out = total(d, sum);
  *total_out = total(d, count);
}

template <Loss kLoss>
double weigh_by(double scale_squared, double curvature, std::size_t size,
                const double* HWY_RESTRICT s, const double* HWY_RESTRICT trust,
                double* HWY_RESTRICT w, double* HWY_RESTRICT c) {
  const D d;
  const V zero = hn::Zero(d);
  const V c2 = hn::Set(d, scale_squared);
  const V scale = hn::Sqrt(c2);
  const V factor = hn::Set(d, curvature);
  V cost = zero;
  for (std::size_t i = 0; i < size; i += hn::Lanes(d)) {
    const V raw = hn::Load(d, s + i);
    const V t = hn::Load(d, trust + i);
    const M front = hn::Ge(raw, zero);
    const V si = hn::IfThenElse(front, raw, hn::Set(d, kBehindSquared));
    V wi = t, ci = zero, rho = si;
    if constexpr (kLoss == Loss::kGemanMcClure) {
      const V inv = hn::Div(hn::Set(d, 1.0), hn::Add(c2, si));
      const V ratio = hn::Mul(c2, inv);
      rho = hn::Mul(si, ratio);
      wi = hn::Mul(t, hn::Mul(ratio, ratio));
      ci = hn::Mul(hn::Mul(hn::Set(d, -4.0), factor), hn::Mul(wi, inv));
    } else if constexpr (kLoss == Loss::kHuber) {
      const M outside = hn::Gt(si, c2);
      const V root = hn::Sqrt(hn::Max(si, c2));
      const V inv = hn::Div(scale, root);
      rho = hn::IfThenElse(outside, hn::MulSub(hn::Add(scale, scale), root, c2), si);
      wi = hn::Mul(t, hn::IfThenElse(outside, inv, hn::Set(d, 1.0)));
      ci = hn::IfThenElseZero(outside, hn::Neg(hn::Div(hn::Mul(factor, wi), hn::Max(si, c2))));
    }
    cost = hn::MulAdd(t, rho, cost);
    hn::Store(hn::IfThenElseZero(front, wi), d, w + i);
    hn::Store(hn::IfThenElseZero(front, ci), d, c + i);
  }
  return 0.5 * total(d, cost);
}

double weigh(Loss loss, double scale_squared, double curvature, std::size_t size, const double* s,
             const double* trust, double* w, double* c) {
  switch (loss) {
    case Loss::kHuber:
      return weigh_by<Loss::kHuber>(scale_squared, curvature, size, s, trust, w, c);
    case Loss::kGemanMcClure:
      return weigh_by<Loss::kGemanMcClure>(scale_squared, curvature, size, s, trust, w, c);
    case Loss::kLeastSquares:
      break;
  }
  return weigh_by<Loss::kLeastSquares>(scale_squared, curvature, size, s, trust, w, c);
}

double weigh_joint(double lambda, double cross, std::size_t size, const double* HWY_RESTRICT s,
                   const double* HWY_RESTRICT active, const double* HWY_RESTRICT phi0,
                   const double* HWY_RESTRICT phi, double* HWY_RESTRICT w, double* HWY_RESTRICT c,
                   double* HWY_RESTRICT gw) {
  const D d;
  const V zero = hn::Zero(d);
  const V lam = hn::Set(d, lambda), k = hn::Set(d, cross);
  V cost = zero;
  for (std::size_t i = 0; i < size; i += hn::Lanes(d)) {
    const V raw = hn::Load(d, s + i);
    const M front = hn::Ge(raw, zero);
    const V si = hn::IfThenElse(front, raw, hn::Set(d, kBehindSquared));
    const V prior = hn::Load(d, phi0 + i);
    const V A = hn::Add(si, lam);
    const V inv = hn::Div(hn::Set(d, 1.0), A);
    // A point behind the camera has no cross term, so its weight is at its own minimum at once.
    const V f = hn::IfThenElse(front, hn::Load(d, phi + i), hn::Mul(hn::Mul(lam, prior), inv));
    const V off = hn::Sub(f, prior);
    const V on = hn::Load(d, active + i);
    const V f2 = hn::Mul(f, f);
    cost = hn::MulAdd(on, hn::MulAdd(f2, si, hn::Mul(lam, hn::Mul(off, off))), cost);
    const V slope = hn::MulAdd(f, si, hn::Mul(lam, off));  // derivative of the cost by phi
    const V used = hn::IfThenElseZero(front, on);
    hn::Store(hn::Mul(used, f2), d, w + i);
    hn::Store(hn::Mul(used, hn::Neg(hn::Mul(hn::Mul(k, k), hn::Mul(f2, inv)))), d, c + i);
    const V coupled = hn::Mul(hn::Mul(k, f), hn::Mul(slope, inv));
    hn::Store(hn::Mul(used, hn::Sub(f2, coupled)), d, gw + i);
  }
  return 0.5 * total(d, cost);
}

// Rows of the derivative of (u, v, u_R) by the left perturbation, and q = J' S^-1 r.
// u: [u0 0 u2 u3 u4 u5]; v: [0 v1 v2 v3 v4 v5]; u_R: [u0 0 r2 r3 r4 u5].
struct Rows {
  V u0, u2, u3, u4, u5, v1, v2, v3, v4, v5, r2, r3, r4;
  V q0, q1, q2, q3, q4, q5;
};

HWY_INLINE Rows derive(D d, const View& view, const Points& p, std::size_t i, const Projected& a) {
  const V one = hn::Set(d, 1.0);
  const V fx = hn::Set(d, view.fx), fy = hn::Set(d, view.fy);
  const V xy = hn::Mul(a.x, a.y);
  Rows j;
  j.u0 = hn::Mul(fx, a.inv_z);
  j.u2 = hn::Neg(hn::Mul(j.u0, a.x));
  j.u3 = hn::Neg(hn::Mul(fx, xy));
  j.u4 = hn::Mul(fx, hn::MulAdd(a.x, a.x, one));
  j.u5 = hn::Neg(hn::Mul(fx, a.y));
  j.v1 = hn::Mul(fy, a.inv_z);
  j.v2 = hn::Neg(hn::Mul(j.v1, a.y));
  j.v3 = hn::Neg(hn::Mul(fy, hn::MulAdd(a.y, a.y, one)));
  j.v4 = hn::Mul(fy, xy);
  j.v5 = hn::Mul(fy, a.x);
  const V b = hn::Mul(hn::Set(d, view.bf), a.inv_z);
  j.r2 = hn::MulAdd(b, a.inv_z, j.u2);
  j.r3 = hn::MulAdd(b, a.y, j.u3);
  j.r4 = hn::NegMulAdd(b, a.x, j.u4);
  const V info = hn::Load(d, p.info + i);
  const V eu = hn::Mul(info, a.ru), ev = hn::Mul(info, a.rv);
  const V er = hn::Mul(hn::Load(d, p.info_right + i), a.rr);
  const V eur = hn::Add(eu, er);
  j.q0 = hn::Mul(j.u0, eur);
  j.q1 = hn::Mul(j.v1, ev);
  j.q2 = hn::MulAdd(j.u2, eu, hn::MulAdd(j.v2, ev, hn::Mul(j.r2, er)));
  j.q3 = hn::MulAdd(j.u3, eu, hn::MulAdd(j.v3, ev, hn::Mul(j.r3, er)));
  j.q4 = hn::MulAdd(j.u4, eu, hn::MulAdd(j.v4, ev, hn::Mul(j.r4, er)));
  j.q5 = hn::MulAdd(j.u5, eur, hn::Mul(j.v5, ev));
  return j;
}

void normal_equations(const View& view, const Points& p, const double* HWY_RESTRICT w,
                      const double* HWY_RESTRICT c, const double* HWY_RESTRICT gw,
                      Normal* HWY_RESTRICT normal) {
  const D d;
  const V zero = hn::Zero(d);
  V h00 = zero, h01 = zero, h02 = zero, h03 = zero, h04 = zero, h05 = zero, h11 = zero;
  V h12 = zero, h13 = zero, h14 = zero, h15 = zero, h22 = zero, h23 = zero, h24 = zero;
  V h25 = zero, h33 = zero, h34 = zero, h35 = zero, h44 = zero, h45 = zero, h55 = zero;
  V g0 = zero, g1 = zero, g2 = zero, g3 = zero, g4 = zero, g5 = zero;
  for (std::size_t i = 0; i < p.size; i += hn::Lanes(d)) {
    const Projected a = project(d, view, p, i);
    const Rows j = derive(d, view, p, i, a);
    const V weight = hn::Load(d, w + i);
    const V wi = hn::Mul(weight, hn::Load(d, p.info + i));
    const V wr = hn::Mul(weight, hn::Load(d, p.info_right + i));
    const V wur = hn::Add(wi, wr);
    const V ci = hn::Load(d, c + i), gi = hn::Load(d, gw + i);
    // Row by row of the upper triangle: three measurement rows and the curvature c q q'.
    V cq = hn::Mul(ci, j.q0), au = hn::Mul(wi, j.u0), ar = hn::Mul(wr, j.u0);
    h00 = hn::MulAdd(hn::Mul(wur, j.u0), j.u0, hn::MulAdd(cq, j.q0, h00));
    h01 = hn::MulAdd(cq, j.q1, h01);
    h02 = hn::MulAdd(au, j.u2, hn::MulAdd(ar, j.r2, hn::MulAdd(cq, j.q2, h02)));
    h03 = hn::MulAdd(au, j.u3, hn::MulAdd(ar, j.r3, hn::MulAdd(cq, j.q3, h03)));
    h04 = hn::MulAdd(au, j.u4, hn::MulAdd(ar, j.r4, hn::MulAdd(cq, j.q4, h04)));
    h05 = hn::MulAdd(hn::Mul(wur, j.u0), j.u5, hn::MulAdd(cq, j.q5, h05));
    g0 = hn::MulAdd(gi, j.q0, g0);

    V av = hn::Mul(wi, j.v1);
    cq = hn::Mul(ci, j.q1);
    h11 = hn::MulAdd(av, j.v1, hn::MulAdd(cq, j.q1, h11));
    h12 = hn::MulAdd(av, j.v2, hn::MulAdd(cq, j.q2, h12));
    h13 = hn::MulAdd(av, j.v3, hn::MulAdd(cq, j.q3, h13));
    h14 = hn::MulAdd(av, j.v4, hn::MulAdd(cq, j.q4, h14));
    h15 = hn::MulAdd(av, j.v5, hn::MulAdd(cq, j.q5, h15));
    g1 = hn::MulAdd(gi, j.q1, g1);

    au = hn::Mul(wi, j.u2), av = hn::Mul(wi, j.v2), ar = hn::Mul(wr, j.r2);
    cq = hn::Mul(ci, j.q2);
    const auto four = [](V x0, V y0, V x1, V y1, V x2, V y2, V x3, V y3, V sum) HWY_ATTR {
      return hn::MulAdd(x0, y0, hn::MulAdd(x1, y1, hn::MulAdd(x2, y2, hn::MulAdd(x3, y3, sum))));
    };
    h22 = four(au, j.u2, av, j.v2, ar, j.r2, cq, j.q2, h22);
    h23 = four(au, j.u3, av, j.v3, ar, j.r3, cq, j.q3, h23);
    h24 = four(au, j.u4, av, j.v4, ar, j.r4, cq, j.q4, h24);
    h25 = four(au, j.u5, av, j.v5, ar, j.u5, cq, j.q5, h25);
    g2 = hn::MulAdd(gi, j.q2, g2);

    au = hn::Mul(wi, j.u3), av = hn::Mul(wi, j.v3), ar = hn::Mul(wr, j.r3);
    cq = hn::Mul(ci, j.q3);
    h33 = four(au, j.u3, av, j.v3, ar, j.r3, cq, j.q3, h33);
    h34 = four(au, j.u4, av, j.v4, ar, j.r4, cq, j.q4, h34);
    h35 = four(au, j.u5, av, j.v5, ar, j.u5, cq, j.q5, h35);
    g3 = hn::MulAdd(gi, j.q3, g3);

    au = hn::Mul(wi, j.u4), av = hn::Mul(wi, j.v4), ar = hn::Mul(wr, j.r4);
    cq = hn::Mul(ci, j.q4);
    h44 = four(au, j.u4, av, j.v4, ar, j.r4, cq, j.q4, h44);
    h45 = four(au, j.u5, av, j.v5, ar, j.u5, cq, j.q5, h45);
    g4 = hn::MulAdd(gi, j.q4, g4);

    h55 = hn::MulAdd(hn::Mul(wur, j.u5), j.u5, hn::MulAdd(hn::Mul(wi, j.v5), j.v5, h55));
    h55 = hn::MulAdd(hn::Mul(ci, j.q5), j.q5, h55);
    g5 = hn::MulAdd(gi, j.q5, g5);
  }
  double* H = normal->H;
  H[0] = total(d, h00), H[1] = total(d, h01), H[2] = total(d, h02), H[3] = total(d, h03);
  H[4] = total(d, h04), H[5] = total(d, h05), H[6] = total(d, h11), H[7] = total(d, h12);
  H[8] = total(d, h13), H[9] = total(d, h14), H[10] = total(d, h15), H[11] = total(d, h22);
  H[12] = total(d, h23), H[13] = total(d, h24), H[14] = total(d, h25), H[15] = total(d, h33);
  H[16] = total(d, h34), H[17] = total(d, h35), H[18] = total(d, h44), H[19] = total(d, h45);
  H[20] = total(d, h55);
  double* g = normal->g;
  g[0] = total(d, g0), g[1] = total(d, g1), g[2] = total(d, g2);
  g[3] = total(d, g3), g[4] = total(d, g4), g[5] = total(d, g5);
}

void step_joint(const View& view, const Points& p, double lambda, double cross, const double* xi,
                const double* HWY_RESTRICT s, const double* HWY_RESTRICT phi0,
                const double* HWY_RESTRICT phi, double* HWY_RESTRICT phi_new) {
  const D d;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0);
  const V lam = hn::Set(d, lambda), k = hn::Set(d, cross);
  for (std::size_t i = 0; i < p.size; i += hn::Lanes(d)) {
    const Projected a = project(d, view, p, i);
    const Rows j = derive(d, view, p, i, a);
    const V raw = hn::Load(d, s + i);
    const M front = hn::Ge(raw, zero);
    const V si = hn::IfThenElse(front, raw, hn::Set(d, kBehindSquared));
    V move = hn::Mul(hn::Set(d, xi[0]), j.q0);
    move = hn::MulAdd(hn::Set(d, xi[1]), j.q1, move);
    move = hn::MulAdd(hn::Set(d, xi[2]), j.q2, move);
    move = hn::MulAdd(hn::Set(d, xi[3]), j.q3, move);
    move = hn::MulAdd(hn::Set(d, xi[4]), j.q4, move);
    move = hn::MulAdd(hn::Set(d, xi[5]), j.q5, move);
    const V inv = hn::Div(one, hn::Add(si, lam));
    const V prior = hn::Load(d, phi0 + i);
    const V f = hn::Load(d, phi + i);
    const V slope = hn::MulAdd(f, si, hn::Mul(lam, hn::Sub(f, prior)));
    // q points along decreasing cost, hence the sign of the coupling.
    const V step = hn::Mul(hn::Sub(hn::Mul(hn::Mul(k, f), move), slope), inv);
    const V moved = hn::Min(hn::Max(hn::Add(f, step), zero), one);
    hn::Store(hn::IfThenElse(front, moved, hn::Mul(hn::Mul(lam, prior), inv)), d, phi_new + i);
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace dynslam::factors::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace dynslam::factors::kernels {

HWY_EXPORT(residuals);
HWY_EXPORT(mean_residual);
HWY_EXPORT(weigh);
HWY_EXPORT(weigh_joint);
HWY_EXPORT(normal_equations);
HWY_EXPORT(step_joint);

void residuals(const View& view, const Points& points, double* s) {
  HWY_DYNAMIC_DISPATCH(residuals)(view, points, s);
}

void mean_residual(std::size_t size, const double* s, const double* trust, double* sum,
                   double* total) {
  HWY_DYNAMIC_DISPATCH(mean_residual)(size, s, trust, sum, total);
}

double weigh(Loss loss, double scale_squared, double curvature, std::size_t size, const double* s,
             const double* trust, double* w, double* c) {
  return HWY_DYNAMIC_DISPATCH(weigh)(loss, scale_squared, curvature, size, s, trust, w, c);
}

double weigh_joint(double lambda, double cross, std::size_t size, const double* s,
                   const double* active, const double* phi0, const double* phi, double* w,
                   double* c, double* gw) {
  return HWY_DYNAMIC_DISPATCH(weigh_joint)(lambda, cross, size, s, active, phi0, phi, w, c, gw);
}

void normal_equations(const View& view, const Points& points, const double* w, const double* c,
                      const double* gw, Normal* normal) {
  HWY_DYNAMIC_DISPATCH(normal_equations)(view, points, w, c, gw, normal);
}

void step_joint(const View& view, const Points& points, double lambda, double cross,
                const double* xi, const double* s, const double* phi0, const double* phi,
                double* phi_new) {
  HWY_DYNAMIC_DISPATCH(step_joint)
  (view, points, lambda, cross, xi, s, phi0, phi, phi_new);
}

}  // namespace dynslam::factors::kernels
#endif
