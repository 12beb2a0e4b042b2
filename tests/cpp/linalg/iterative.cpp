// Krylov methods with each preconditioner, and Newton.
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <complex>
#include <limits>

#include "mesh.h"
#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/krylov.h"
#include "substep/linalg/newton.h"
#include "substep/linalg/preconditioners.h"

namespace substep {
namespace {

template <class T>
struct Problem {
  Mesh<T> a;        // whole
  Mesh<T> flipped;  // its transpose, for products
  std::vector<T> b;
  LinearOperator<T> product;

  Problem(int side, double shift, double skew) : a(mesh<T>(side, false, shift, skew)) {
    if constexpr (!std::is_same_v<T, double>) {
      for (std::size_t k = 0; k < a.values.size(); ++k) a.values[k] *= T(1, 0.01 * (k % 7));
    }
    std::vector<std::int32_t> entry;
    flipped.pattern = transposed(a.pattern, &entry);
    for (const auto k : entry) flipped.values.push_back(a.values[usize(k)]);
    b = right_side<T>(usize(a.pattern.rows));
    product = with_threads(1);
  }

  LinearOperator<T> with_threads(int threads) const {
    return [this, threads](std::span<const T> x, std::span<T> y) {
      multiply_transposed<T>(flipped.pattern, flipped.values, x, y, threads);
    };
  }
};

TEST(ConjugateGradients, ConvergesWithEveryPreconditioner) {
  const Problem<double> p(30, 0.15, 0);
  const auto lower = mesh<double>(30, true, 0.15, 0);
  const std::vector<LinearOperator<double>> preconditioners{
      {},
      diagonal_preconditioner<double>(p.a.pattern, p.a.values),
      block_diagonal_preconditioner(p.a.pattern, p.a.values, 3, false),
      incomplete_cholesky(lower.pattern, lower.values)};
  std::vector<int> iterations;
  for (const auto& m : preconditioners) {
    std::vector<double> x(p.b.size(), 0.0);
    const KrylovReport report = cg(p.product, p.b, x, {.rtol = 1e-12}, m);
    EXPECT_TRUE(report.converged) << report.remedy;
    EXPECT_LT(residual(p.a, x, p.b), 1e-11);
    EXPECT_EQ(report.residuals.size(), usize(report.iterations) + 1);
    iterations.push_back(report.iterations);
  }
  EXPECT_LT(iterations[3], 0.6 * iterations[1]);  // IC(0) against the diagonal
}

TEST(ConjugateGradients, BlocksOfALowerTriangleAreThoseOfTheWhole) {
  const Problem<double> p(8, 0.15, 0);
  const auto lower = mesh<double>(8, true, 0.15, 0);
  std::vector<double> z(p.b.size()), w(p.b.size());
  block_diagonal_preconditioner(p.a.pattern, p.a.values, 3, false)(p.b, z);
  block_diagonal_preconditioner(lower.pattern, lower.values, 3, true)(p.b, w);
  EXPECT_EQ(z, w);
}

TEST(ConjugateGradients, SameBitsForAnyNumberOfThreads) {
  const Problem<double> p(80, 0.15, 0);  // 19,200 unknowns: three chunks of every sum
  std::vector<std::vector<double>> answers;
  for (const int threads : {1, 2, 3}) {
    answers.emplace_back(p.b.size(), 0.0);
    cg(p.with_threads(threads), p.b, answers.back(), {.rtol = 1e-10, .threads = threads},
       diagonal_preconditioner<double>(p.a.pattern, p.a.values, threads));
  }
  EXPECT_EQ(answers[0], answers[1]);
  EXPECT_EQ(answers[0], answers[2]);
}

TEST(ConjugateGradients, SaysWhatIsIndefinite) {
  const Problem<double> p(10, -6, 0);
  std::vector<double> x(p.b.size(), 0.0);
  const KrylovReport report = cg(p.product, p.b, x);
  EXPECT_FALSE(report.converged);
  EXPECT_TRUE(report.indefinite);
  EXPECT_FALSE(report.remedy.empty());
}

TEST(ConjugateGradients, StopsAtItsLimitAndLeavesTheGuessWhereNumbersFail) {
  const Problem<double> p(20, 0.15, 0);
  std::vector<double> x(p.b.size(), 0.0);
  const KrylovReport report = cg(p.product, p.b, x, {.rtol = 1e-12, .max_iterations = 3});
  EXPECT_FALSE(report.converged);
  EXPECT_EQ(report.iterations, 3);
  auto b = p.b;
  b[5] = std::numeric_limits<double>::infinity();
  const auto before = x;
  EXPECT_THROW(cg(p.product, b, x), NonFiniteError);
  EXPECT_EQ(x, before);
}

TEST(ConjugateGradients, ZeroRightSideIsAnsweredAtOnce) {
  const Problem<double> p(5, 0.15, 0);
  std::vector<double> x(p.b.size(), 0.0);
  const std::vector<double> zero(p.b.size(), 0.0);
  const KrylovReport report = cg(p.product, zero, x);
  EXPECT_TRUE(report.converged);
  EXPECT_EQ(report.iterations, 0);
}

template <class T>
class Bicgstab : public testing::Test {};
using Scalars = testing::Types<double, std::complex<double>>;
TYPED_TEST_SUITE(Bicgstab, Scalars);

TYPED_TEST(Bicgstab, ConvergesOnUnsymmetricMatrices) {
  using T = TypeParam;
  const Problem<T> p(30, 0.3, 0.04);
  const std::vector<LinearOperator<T>> preconditioners{
      {},
      diagonal_preconditioner<T>(p.a.pattern, p.a.values),
      incomplete_lu<T>(p.a.pattern, p.a.values)};
  std::vector<int> iterations;
  for (const auto& m : preconditioners) {
    std::vector<T> x(p.b.size(), T{});
    const KrylovReport report = bicgstab<T>(p.product, p.b, x, {.rtol = 1e-11}, m);
    EXPECT_TRUE(report.converged) << report.remedy;
    EXPECT_LT(residual(p.a, x, p.b), 1e-9);
    iterations.push_back(report.iterations);
  }
  EXPECT_LT(iterations[2], iterations[1]);
}

TYPED_TEST(Bicgstab, SameBitsForAnyNumberOfThreads) {
  using T = TypeParam;
  const Problem<T> p(60, 0.5, 0.04);
  std::vector<std::vector<T>> answers;
  for (const int threads : {1, 2, 3}) {
    answers.emplace_back(p.b.size(), T{});
    bicgstab<T>(p.with_threads(threads), p.b, answers.back(), {.threads = threads});
  }
  EXPECT_EQ(answers[0], answers[1]);
  EXPECT_EQ(answers[0], answers[2]);
}

// E = sum (1 - x_i)^2 + 100 (x_{i+1} - x_i^2)^2, Rosenbrock's valley, in two unknowns.
struct Rosenbrock {
  int solves = 0;
  double merit(std::span<const double> x) const {
    const double a = 1 - x[0], b = x[1] - x[0] * x[0];
    return a * a + 100 * b * b;
  }
  void gradient(std::span<const double> x, std::span<double> g) const {
    const double b = x[1] - x[0] * x[0];
    g[0] = -2 * (1 - x[0]) - 400 * x[0] * b;
    g[1] = 200 * b;
  }
  double residual(std::span<const double> g) const {
    return std::max(std::abs(g[0]), std::abs(g[1])) / 1e-10;
  }
  double direction(std::span<const double> x, std::span<const double> g, double,
                   std::span<double> d) {
    ++solves;
    Eigen::Matrix<double, 2, 2> h;
    h << 2 - 400 * (x[1] - 3 * x[0] * x[0]), -400 * x[0], -400 * x[0], 200;
    // Made positive definite, so that the direction descends.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(h);
    const Eigen::Vector2d along = eigen.eigenvectors().transpose() * Eigen::Vector2d(g[0], g[1]);
    const Eigen::Vector2d step =
        eigen.eigenvectors() * -along.cwiseQuotient(eigen.eigenvalues().cwiseMax(1e-6));
    d[0] = step[0], d[1] = step[1];
    return g[0] * d[0] + g[1] * d[1];
  }
};

TEST(Newton, FindsTheEndOfRosenbrocksValley) {
  Rosenbrock problem;
  std::vector<double> x{-1.2, 1.0};
  const NewtonReport report = newton(problem, x);
  EXPECT_TRUE(report.converged) << report.remedy;
  EXPECT_NEAR(x[0], 1, 1e-10);
  EXPECT_GT(report.halvings, 0);
  EXPECT_EQ(problem.solves, report.iterations);
  EXPECT_LE(report.residuals.back(), 1);
  // Quadratic at the end: each residual below a multiple of the square of the one before.
  const auto& r = report.residuals;
  EXPECT_LT(r[r.size() - 1] * 1e-10, 1e3 * std::pow(r[r.size() - 2] * 1e-10, 2) + 1e-12);
}

TEST(Newton, SaysWhenItRunsOutOfIterations) {
  Rosenbrock problem;
  std::vector<double> x{-1.2, 1.0};
  const NewtonReport report = newton(problem, x, {.max_iterations = 2});
  EXPECT_FALSE(report.converged);
  EXPECT_EQ(report.iterations, 2);
  EXPECT_FALSE(report.remedy.empty());
}

// x^2 + 1 = 0 has no root: the line search ends at the minimum of |F|.
struct NoRoot {
  double merit(std::span<const double> x) const { return std::pow(x[0] * x[0] + 1, 2) / 2; }
  void gradient(std::span<const double> x, std::span<double> g) const { g[0] = x[0] * x[0] + 1; }
  double residual(std::span<const double> g) const { return std::abs(g[0]) / 1e-8; }
  double direction(std::span<const double> x, std::span<const double> g, double,
                   std::span<double> d) const {
    d[0] = -g[0] / (2 * x[0]);
    return -g[0] * g[0];
  }
};

TEST(Newton, SaysWhenThereIsNoRoot) {
  std::vector<double> x{0.7};
  const NewtonReport report = newton(NoRoot{}, x);
  EXPECT_FALSE(report.converged);
  EXPECT_FALSE(report.remedy.empty());
}

}  // namespace
}  // namespace substep
