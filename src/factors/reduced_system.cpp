#include <algorithm>

#include "factors/schur_kernels.hpp"
#include "factors/schur_solver.hpp"

namespace dynslam::factors {
namespace {

// Up to this many cameras a dense factorization wins whatever the pattern; above the second number
// the matrix would not fit.
constexpr std::size_t kAlwaysDense = 40;
constexpr std::size_t kNeverDense = 1500;
constexpr double kDenseFill = 0.4;

}  // namespace

void ReducedSystem::analyze(std::size_t cameras,
                            const std::vector<std::pair<std::uint32_t, std::uint32_t>>& pairs) {
  cameras_ = cameras;
  pairs_ = pairs;
  const auto n = static_cast<Eigen::Index>(6 * cameras);
  const double fill = static_cast<double>(pairs.size()) /
                      (0.5 * static_cast<double>(cameras) * static_cast<double>(cameras + 1));
  dense_ = cameras <= kAlwaysDense || (cameras <= kNeverDense && fill > kDenseFill);
  if (dense_) {
    matrix_.setZero(n, n);
    return;
  }
  // Lower triangle: block (row, column) of the upper one lies transposed in block column `row`.
  std::vector<std::vector<std::pair<std::uint32_t, std::size_t>>> columns(cameras);
  for (std::size_t k = 0; k < pairs.size(); ++k)
    columns[pairs[k].first].push_back({pairs[k].second, k});
  slot_.assign(pairs.size(), 0);
  sparse_.resize(n, n);
  sparse_.reserve(static_cast<Eigen::Index>(36 * pairs.size()));
  std::size_t start = 0;
  for (std::size_t c = 0; c < cameras; ++c) {
    std::sort(columns[c].begin(), columns[c].end());
    for (std::size_t k = 0; k < columns[c].size(); ++k) slot_[columns[c][k].second] = start + 6 * k;
    start += 36 * columns[c].size();
    for (int j = 0; j < 6; ++j) {
      const auto column = static_cast<Eigen::Index>(6 * c) + j;
      sparse_.startVec(column);
      for (const auto& [row, unused] : columns[c])
        for (int i = 0; i < 6; ++i)
          sparse_.insertBack(static_cast<Eigen::Index>(6 * row) + i, column) = 0.0;
    }
  }
  sparse_.finalize();
  factor_.analyzePattern(sparse_);
}

bool ReducedSystem::solve(const double* blocks, const double* rhs, Eigen::VectorXd* x) {
  x->resize(static_cast<Eigen::Index>(6 * cameras_));
  for (std::size_t c = 0; c < cameras_; ++c)
    for (std::size_t i = 0; i < 6; ++i)
      (*x)[static_cast<Eigen::Index>(6 * c + i)] = rhs[c * kernels::kColumn + i];
  return dense_ ? solve_dense(blocks, x) : solve_sparse(blocks, x);
}

bool ReducedSystem::solve_dense(const double* blocks, Eigen::VectorXd* x) {
  matrix_.setZero();  // the last factor filled blocks that have no pair
  using Block = Eigen::Map<const Matrix6d, 0, Eigen::OuterStride<kernels::kColumn>>;
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    matrix_.block<6, 6>(6 * pairs_[k].second, 6 * pairs_[k].first) =
        Block(blocks + k * kernels::kSquare).transpose();
  }
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>, Eigen::Lower> factor(matrix_);
  if (factor.info() != Eigen::Success) return false;
  factor.solveInPlace(*x);
  return x->allFinite();
}

bool ReducedSystem::solve_sparse(const double* blocks, Eigen::VectorXd* x) {
  double* values = sparse_.valuePtr();
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    const double* block = blocks + k * kernels::kSquare;
    const auto column = static_cast<Eigen::Index>(6 * pairs_[k].first);
    const Eigen::Index height =
        sparse_.outerIndexPtr()[column + 1] - sparse_.outerIndexPtr()[column];
    for (std::size_t j = 0; j < 6; ++j)
      for (std::size_t i = 0; i < 6; ++i)
        values[slot_[k] + j * static_cast<std::size_t>(height) + i] =
            block[i * kernels::kColumn + j];
  }
  factor_.factorize(sparse_);
  if (factor_.info() != Eigen::Success) return false;
  *x = factor_.solve(*x).eval();
  return x->allFinite();
}

}  // namespace dynslam::factors
