// Numeric derivatives, to check analytic ones. Public: users check their own
// factors with it.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

#include <Eigen/Core>

namespace dynslam {

/// Jacobian of f at x by central differences with one Richardson step, error
/// O(step^4).
///
/// `f` maps a vector of n to a vector of m; `x` may be a small perturbation
/// that f applies itself (e.g. xi -> residual(exp(xi) T) at xi = 0). Cost: 4 n
/// evaluations of f. Not for production use.
template <typename Function, int N>
auto numeric_jacobian(const Function& f, const Eigen::Matrix<double, N, 1>& x, double step = 1e-4) {
  using Input = Eigen::Matrix<double, N, 1>;
  const auto f0 = f(x).eval();
  constexpr int kRows = std::decay_t<decltype(f0)>::RowsAtCompileTime;
  Eigen::Matrix<double, kRows, N> J(f0.size(), x.size());
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    const double h = step * std::max(1.0, std::abs(x[i]));
    const auto central = [&](double d) {
      Input plus = x, minus = x;
      plus[i] += d;
      minus[i] -= d;
      return ((f(plus) - f(minus)) / (2.0 * d)).eval();
    };
    J.col(i) = (4.0 * central(0.5 * h) - central(h)) / 3.0;
  }
  return J;
}

/// Largest difference between two Jacobians relative to the larger one's
/// largest entry (or to 1). NaN anywhere gives NaN, which no bound passes.
template <typename A, typename B>
double jacobian_difference(const Eigen::MatrixBase<A>& analytic,
                           const Eigen::MatrixBase<B>& numeric) {
  const double scale = std::max(1.0, numeric.cwiseAbs().maxCoeff());
  const auto difference = (analytic - numeric).cwiseAbs().eval();
  return difference.allFinite() ? difference.maxCoeff() / scale
                                : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace dynslam
