// The Cholesky factorization in float32: solutions are those of float64, and matrices beyond
// float32 are factorized in float64.
#include "substep/linalg/direct/mixed_cholesky.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "substep/core/random.h"
#include "substep/core/usize.h"

namespace substep {
namespace {

// The Laplacian of a chain of n vertices, times `scale`, in each of three directions; plus `mass`
// on the diagonal.
struct Chain {
  explicit Chain(std::int32_t n, double scale = 1.0, double mass = 1e-3)
      : lower{3 * n, 3 * n, {0}, {}} {
    for (std::int32_t c = 0; c < 3 * n; ++c) {
      for (std::int32_t r = c; r < 3 * (c / 3 + 1); ++r) add(r, r == c ? 2.0 * scale + mass : 0.0);
      for (std::int32_t r = 3 * (c / 3 + 1); r < std::min(3 * n, 3 * (c / 3 + 2)); ++r) {
        add(r, r == c + 3 ? -scale : 0.0);
      }
      lower.start.push_back(static_cast<std::int32_t>(lower.row.size()));
    }
  }
  void add(std::int32_t row, double value) {
    lower.row.push_back(row);
    values.push_back(value);
  }

  // |b - A x| / |b|
  double residual(std::span<const double> x, std::span<const double> b) const {
    std::vector<double> rest(b.begin(), b.end());
    for (std::int32_t c = 0; c < lower.cols; ++c) {
      for (std::int32_t k = lower.start[c]; k < lower.start[c + 1]; ++k) {
        const std::int32_t r = lower.row[k];
        rest[r] -= values[k] * x[c];
        if (r != c) rest[c] -= values[k] * x[r];
      }
    }
    double rests = 0.0, sizes = 0.0;
    for (std::size_t i = 0; i < rest.size(); ++i) {
      rests += (rest[i] / b[0]) * (rest[i] / b[0]);
      sizes += (b[i] / b[0]) * (b[i] / b[0]);
    }
    return std::sqrt(rests / sizes);
  }

  SparsePattern lower;
  std::vector<double> values;
};

std::vector<double> numbers(std::size_t n, double scale = 1.0) {
  std::vector<double> b(n);
  for (std::size_t i = 0; i < n; ++i) b[i] = scale * (uniform2(7, i)[0] - 0.5);
  return b;
}

TEST(MixedCholesky, SolvesAsFloat64DoesWithTheSameBitsForAnyNumberOfThreads) {
  const Chain chain(400);
  MixedCholesky cholesky(chain.lower, 3);
  const std::vector<double> b = numbers(1200);
  std::vector<double> first;
  for (const int threads : {1, 2, 3}) {
    ASSERT_EQ(cholesky.factorize(chain.values, threads), -1);
    std::vector<double> rough = b, x = b;
    cholesky.solve(rough, threads);
    EXPECT_LT(chain.residual(rough, b), 1e-2);
    EXPECT_GT(chain.residual(rough, b), 1e-9);  // it is in float32
    ASSERT_TRUE(cholesky.solve(x, chain.values, 1e-12, threads));
    EXPECT_LT(chain.residual(x, b), 1e-11);
    if (threads == 1) first = x;
    EXPECT_EQ(first, x) << threads << " threads";
  }
}

TEST(MixedCholesky, GoesToFloat64WhereTheRangeOrTheConditionIsBeyondFloat32) {
  for (const double scale : {1e60, 1e-60}) {
    const Chain chain(50, scale, 1e-3 * scale);
    MixedCholesky cholesky(chain.lower, 3);
    const std::vector<double> b = numbers(150);
    std::vector<double> x = b;
    ASSERT_EQ(cholesky.factorize(chain.values, 1), -1);
    ASSERT_TRUE(cholesky.solve(x, chain.values, 1e-6, 1));
    EXPECT_LT(chain.residual(x, b), 1e-12) << scale;
  }
  const Chain stiff(2000, 1e9, 1e-6);  // condition 1e15
  MixedCholesky cholesky(stiff.lower, 3);
  const std::vector<double> b = numbers(6000);
  std::vector<double> x = b;
  ASSERT_EQ(cholesky.factorize(stiff.values, 1), -1);
  ASSERT_TRUE(cholesky.solve(x, stiff.values, 1e-6, 1));
  EXPECT_LT(stiff.residual(x, b), 1e-6);
}

TEST(MixedCholesky, TakesRightHandSidesOfAnySize) {
  const Chain chain(50);
  MixedCholesky cholesky(chain.lower, 3);
  ASSERT_EQ(cholesky.factorize(chain.values, 1), -1);
  for (const double scale : {1e-250, 1e-60, 1e60, 1e250}) {
    const std::vector<double> b = numbers(150, scale);
    std::vector<double> rough = b, x = b;
    cholesky.solve(rough, 1);
    EXPECT_LT(chain.residual(rough, b), 1e-3) << scale;
    ASSERT_TRUE(cholesky.solve(x, chain.values, 1e-9, 1));
    EXPECT_LT(chain.residual(x, b), 1e-9) << scale;
  }
  std::vector<double> zero(150, 0.0);
  ASSERT_TRUE(cholesky.solve(zero, chain.values, 1e-9, 1));
  EXPECT_EQ(zero, std::vector<double>(150, 0.0));
}

TEST(MixedCholesky, DeniesWhatFloat64Denies) {
  const Chain good(50);
  MixedCholesky cholesky(good.lower, 3);
  SupernodalCholesky<> exact(good.lower, 3);
  for (const double bad :
       {-5.0, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    Chain chain(50);
    chain.values[usize(chain.lower.start[60])] = bad;
    EXPECT_EQ(cholesky.factorize(chain.values, 1), exact.factorize(chain.values, 1)) << bad;
    EXPECT_GE(cholesky.factorize(chain.values, 1), 0) << bad;
    EXPECT_EQ(cholesky.factorize(good.values, 1), -1);  // it can be used again
  }
  const Chain singular(50, 0.0, 0.0);
  EXPECT_GE(cholesky.factorize(singular.values, 1), 0);
}

TEST(MixedCholesky, SaysWhereFloat32TookAMatrixForPositiveDefinite) {
  Chain chain(1, 0.0, 1.0);
  // [1 a; a 1] with a beyond 1 by less than float32 sees.
  chain.values[1] = 1.0 + 1e-9;
  MixedCholesky cholesky(chain.lower, 3);
  std::vector<double> x = {1.0, -1.0, 0.5};
  if (cholesky.factorize(chain.values, 1) < 0) {
    EXPECT_FALSE(cholesky.solve(x, chain.values, 1e-6, 1));
  }
}

}  // namespace
}  // namespace substep
