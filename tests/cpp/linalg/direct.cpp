// Direct solvers: residuals, the answer for indefinite matrices, bad input, threads, fork.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <complex>
#include <cstdlib>
#include <limits>
#include <thread>
#include <vector>

#include "mesh.h"
#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/blas_buffers.h"
#include "substep/linalg/direct/cholesky.h"
#include "substep/linalg/direct/library_calls.h"
#include "substep/linalg/direct/lu.h"
#include "substep/linalg/direct/ordering.h"

namespace substep {
namespace {

std::vector<CholeskyKind> cholesky_kinds() {
  if (SUBSTEP_GPL) return {CholeskyKind::simplicial, CholeskyKind::supernodal};
  return {CholeskyKind::simplicial};
}

TEST(Cholesky, SolvesAndKeepsItsAnalysis) {
  const auto whole = mesh<double>(20, false, 0.5, 0);
  auto lower = mesh<double>(20, true, 0.5, 0);
  const auto b = right_side<double>(usize(whole.pattern.rows));
  for (const CholeskyKind kind : cholesky_kinds()) {
    for (const Ordering ordering : {Ordering::amd, Ordering::metis, Ordering::natural}) {
      for (const std::int32_t block : {1, 3}) {
        Cholesky cholesky(lower.pattern, {ordering, kind, block});
        for (int repeat = 0; repeat < 2; ++repeat) {
          EXPECT_TRUE(cholesky.factor(lower.values).factorized);
          std::vector<double> x(b.size());
          cholesky.solve(b, x);
          EXPECT_LT(residual(whole, x, b), 1e-14);
        }
        EXPECT_EQ(cholesky.report().analyses, 1);
        EXPECT_EQ(cholesky.report().factorizations, 2);
        EXPECT_EQ(cholesky.report().supernodal, kind == CholeskyKind::supernodal);
      }
    }
  }
}

TEST(Cholesky, AnIndefiniteMatrixIsAnAnswer) {
  auto lower = mesh<double>(20, true, 0.5, 0);
  const auto good = lower.values;
  const std::int32_t bad = 700;
  lower.values[usize(lower.pattern.find(bad, bad))] = -1;
  for (const CholeskyKind kind : cholesky_kinds()) {
    Cholesky cholesky(lower.pattern, {Ordering::amd, kind, 1});
    const auto& report = cholesky.factor(lower.values);
    EXPECT_FALSE(report.factorized);
    EXPECT_GE(report.column, 0);
    std::vector<double> x(1200, 1.0);
    EXPECT_THROW(cholesky.solve(x, x), SingularMatrixError);
    EXPECT_TRUE(cholesky.factor(good).factorized);
    EXPECT_NO_THROW(cholesky.solve(x, x));
  }
}

TEST(Cholesky, RefusesWhatIsNotFinite) {
  auto lower = mesh<double>(4, true, 0.5, 0);
  Cholesky cholesky(lower.pattern);
  lower.values[7] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(cholesky.factor(lower.values), NonFiniteError);
  EXPECT_THROW(cholesky.factor({lower.values.data(), 3}), InputError);
}

TEST(Cholesky, EmptyAndDiagonal) {
  Cholesky empty(SparsePattern{});
  EXPECT_TRUE(empty.factor({}).factorized);
  empty.solve({}, {});
  Cholesky one(SparsePattern{1, 1, {0, 1}, {0}});
  const std::vector<double> four{4};
  std::vector<double> x{8};
  one.factor(four);
  one.solve(x, x);
  EXPECT_EQ(x[0], 2);
}

// Supernodal CHOLMOD opens OpenMP regions: a child that inherits their threads' ghosts would hang.
TEST(Cholesky, ChildAfterForkFactorizes) {
  const auto lower = mesh<double>(30, true, 0.5, 0);
  Cholesky cholesky(lower.pattern);
  ASSERT_TRUE(cholesky.factor(lower.values).factorized);
  const pid_t child = fork();
  if (child == 0) {
    alarm(20);
    _exit(cholesky.factor(lower.values).factorized ? 0 : 1);
  }
  int status = -1;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

TEST(Cholesky, ThreadsAtOnceGetTheBitsOfOneAlone) {
  const auto lower = mesh<double>(40, true, 0.5, 0);
  const auto b = right_side<double>(usize(lower.pattern.rows));
  const auto solved = [&] {
    Cholesky cholesky(lower.pattern);
    cholesky.factor(lower.values);
    std::vector<double> x(b.size());
    cholesky.solve(b, x);
    return x;
  };
  const auto alone = solved();
  EXPECT_TRUE(blas_is_reentrant());
  std::vector<std::thread> threads;
  std::vector<int> wrong(3, 0);
  for (std::size_t t = 0; t < wrong.size(); ++t) {
    threads.emplace_back([&, t] {
      for (int repeat = 0; repeat < 5; ++repeat) wrong[t] += solved() != alone;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, std::vector<int>(3, 0));
}

TEST(Ordering, MetisLeavesTheProcessAloneAndIsTheSameInEveryThread) {
  const auto lower = mesh<double>(40, true, 0.5, 0);
  std::srand(7);
  const int undisturbed = std::rand();
  std::srand(7);
  const auto alone = elimination_order(lower.pattern, Ordering::metis, 3);
  EXPECT_EQ(std::rand(), undisturbed);
  std::vector<std::thread> threads;
  std::vector<int> wrong(3, 0);
  for (std::size_t t = 0; t < wrong.size(); ++t) {
    threads.emplace_back([&, t] {
      for (int repeat = 0; repeat < 3; ++repeat) {
        wrong[t] += elimination_order(lower.pattern, Ordering::metis, 3) != alone;
        std::rand();
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, std::vector<int>(3, 0));
}

template <class T>
class LUOf : public testing::Test {};
using Scalars = testing::Types<double, std::complex<double>>;
TYPED_TEST_SUITE(LUOf, Scalars);

std::vector<LUKind> lu_kinds() {
  if (SUBSTEP_GPL) return {LUKind::automatic, LUKind::umfpack, LUKind::klu};
  return {LUKind::automatic, LUKind::klu};
}

TYPED_TEST(LUOf, SolvesBothWays) {
  using T = TypeParam;
  auto a = mesh<T>(15, false, 0.5, 0.05);
  if constexpr (!std::is_same_v<T, double>) {
    for (std::size_t k = 0; k < a.values.size(); ++k) a.values[k] *= T(1, 0.01 * (k % 7));
  }
  std::vector<std::int32_t> entry;
  Mesh<T> flipped{transposed(a.pattern, &entry), {}};
  for (const std::int32_t k : entry) flipped.values.push_back(a.values[usize(k)]);
  const auto b = right_side<T>(usize(a.pattern.rows));
  for (const LUKind kind : lu_kinds()) {
    LU<T> lu(a.pattern, kind);
    for (int repeat = 0; repeat < 2; ++repeat) {
      lu.factor(a.values);
      std::vector<T> x(b);
      lu.solve(x, x);
      EXPECT_LT(residual(a, x, b), 1e-13);
      lu.solve(b, x, 1, true);
      EXPECT_LT(residual(flipped, x, b), 1e-13);
    }
    EXPECT_EQ(lu.report().analyses, 1);
    EXPECT_GT(lu.report().rcond, 0);
  }
}

TYPED_TEST(LUOf, SingularMatrixNamesTheRow) {
  using T = TypeParam;
  auto a = mesh<T>(6, false, 0.5, 0.05);
  const auto good = a.values;
  const std::int32_t bad = 50;
  for (std::size_t k = 0; k < a.values.size(); ++k) {
    if (a.pattern.row[k] == bad) a.values[k] = 0;
  }
  for (const LUKind kind : lu_kinds()) {
    LU<T> lu(a.pattern, kind);
    try {
      lu.factor(a.values);
      ADD_FAILURE() << "factorized a singular matrix";
    } catch (const SingularMatrixError& error) {
      EXPECT_EQ(error.index, bad);
    }
    EXPECT_NO_THROW(lu.factor(good));
  }
}

}  // namespace
}  // namespace substep
