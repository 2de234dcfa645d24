// The loops of the pose optimizer over points, on raw pointers; dispatched at run time to the best
// instruction set. Arrays hold one double per point and are readable (and writable) up to the next
// multiple of kPointPadding.
#pragma once

#include <cstddef>

namespace dynslam::factors::kernels {

inline constexpr std::size_t kPointPadding = 64;

// What a point that is not in front of the camera counts: a residual of 1000 sigma. Constant, so
// that it pulls at nothing, and large, so that moving points behind the camera never pays.
inline constexpr double kBehindSquared = 1e6;

struct View {
  double fx, fy, cx, cy, bf;
  double R[9];  // row by row
  double t[3];
};

struct Points {
  std::size_t size = 0;
  const double* x = nullptr;  // world
  const double* y = nullptr;
  const double* z = nullptr;
  const double* u = nullptr;
  const double* v = nullptr;
  const double* right = nullptr;       // 0 for mono
  const double* info = nullptr;        // 1/sigma^2 of u and v
  const double* info_right = nullptr;  // 1/sigma^2 of u_R, 0 for mono
};

// s[i] = r' S^-1 r, or -1 where the point is not in front of the camera.
void residuals(const View& view, const Points& points, double* s);

// Sum over points with trust[i] > 0 of trust[i] * sqrt(s), and of trust[i].
void mean_residual(std::size_t size, const double* s, const double* trust, double* sum,
                   double* total);

// The losses that have a vector form; the others are computed in a plain loop.
enum class Loss { kLeastSquares, kHuber, kGemanMcClure };

// Cost sum trust rho(s) / 2; per point the Gauss-Newton weight w = trust rho' and the curvature
// c = curvature * 2 trust rho''.
double weigh(Loss loss, double scale_squared, double curvature, std::size_t size, const double* s,
             const double* trust, double* w, double* c);

// The same for weights phi that are parameters: cost sum [phi^2 s + lambda (phi - phi0)^2] / 2, w
// and c of the Hessian with phi eliminated, and the weight gw of the gradient with phi eliminated.
// cross is 2 for Newton, 1 for Gauss-Newton. Points with active[i] = 0 do not take part.
double weigh_joint(double lambda, double cross, std::size_t size, const double* s,
                   const double* active, const double* phi0, const double* phi, double* w,
                   double* c, double* gw);

// H = sum w J' S^-1 J + c q q', upper triangle row by row; g = sum gw q, q = -J' S^-1 r.
struct Normal {
  double H[21];
  double g[6];
};
void normal_equations(const View& view, const Points& points, const double* w, const double* c,
                      const double* gw, Normal* normal);

// Newton step of phi after the pose moved by xi from `view`, clamped to [0, 1]. s are the residuals
// at `view`.
void step_joint(const View& view, const Points& points, double lambda, double cross,
                const double* xi, const double* s, const double* phi0, const double* phi,
                double* phi_new);

}  // namespace dynslam::factors::kernels
