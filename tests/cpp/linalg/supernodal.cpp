// The multifrontal Cholesky factorization: residuals, bits, matrices that are not positive
// definite.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/random.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/supernodal_cholesky.h"

namespace substep {
namespace {

struct NetProblem {
  SparsePattern lower;
  std::vector<double> values;
};

// Vertices of a width x width net, each coupled with eight neighbours, by random blocks; diagonally
// dominant.
NetProblem net(std::int32_t width, std::int32_t block) {
  std::vector<std::pair<std::int32_t, std::int32_t>> pairs;
  const auto couple = [&](std::int32_t i, std::int32_t j) {
    for (std::int32_t r = 0; r < block; ++r) {
      for (std::int32_t c = 0; c < block; ++c) {
        const std::int32_t a = block * i + r, b = block * j + c;
        if (i != j || a >= b) pairs.emplace_back(std::max(a, b), std::min(a, b));
      }
    }
  };
  for (std::int32_t y = 0; y < width; ++y) {
    for (std::int32_t x = 0; x < width; ++x) {
      const std::int32_t i = y * width + x;
      couple(i, i);
      if (x + 1 < width) couple(i, i + 1);
      if (y + 1 < width) couple(i, i + width);
      if (x + 1 < width && y + 1 < width) couple(i, i + width + 1);
      if (x > 0 && y + 1 < width) couple(i, i + width - 1);
    }
  }
  const std::int32_t n = block * width * width;
  NetProblem p{build_pattern(n, n, pairs), {}};
  for (std::int32_t c = 0; c < n; ++c) {
    for (std::int32_t k = p.lower.start[c]; k < p.lower.start[c + 1]; ++k) {
      const std::int32_t r = p.lower.row[k];
      p.values.push_back(r == c ? 9.0 * block : uniform2(3, static_cast<std::uint64_t>(k))[0]);
    }
  }
  return p;
}

// The largest component of A x - b, for vectors that lie `stride` apart.
double residual(const NetProblem& p, const double* x, const double* b, std::int64_t stride) {
  std::vector<double> rest(usize(p.lower.cols));
  for (std::int32_t c = 0; c < p.lower.cols; ++c) {
    rest[c] -= b[stride * c];
    for (std::int32_t k = p.lower.start[c]; k < p.lower.start[c + 1]; ++k) {
      const std::int32_t r = p.lower.row[k];
      rest[r] += p.values[k] * x[stride * c];
      if (r != c) rest[c] += p.values[k] * x[stride * r];
    }
  }
  double largest = 0.0;
  for (const double part : rest) largest = std::max(largest, std::abs(part));
  return largest;
}

class Supernodal : public testing::TestWithParam<std::tuple<std::int32_t, std::int32_t, Ordering>> {
};

TEST_P(Supernodal, SolvesToRoundingWithTheSameBitsForAnyNumberOfThreads) {
  const auto [width, block, ordering] = GetParam();
  const NetProblem p = net(width, block);
  SupernodalCholesky cholesky(p.lower, block, ordering);
  std::vector<double> b(usize(3 * width * width)), first;
  for (std::size_t i = 0; i < b.size(); ++i) b[i] = uniform2(4, i)[0] - 0.5;
  for (const int threads : {1, 2, 3}) {
    ASSERT_EQ(cholesky.factorize(p.values, threads), -1);
    std::vector<double> x = b;
    cholesky.solve(x, threads);
    if (block == 3) {
      EXPECT_LT(residual(p, x.data(), b.data(), 1), 1e-13);
    } else {
      for (int side = 0; side < 3; ++side) {
        EXPECT_LT(residual(p, x.data() + side, b.data() + side, 3), 1e-13);
      }
    }
    if (threads == 1) first = x;
    EXPECT_EQ(first, x) << threads << " threads";
  }
}

TEST_P(Supernodal, SolvesForSeveralRightHandSidesAsForEach) {
  const auto [width, block, ordering] = GetParam();
  const NetProblem p = net(width, block);
  SupernodalCholesky cholesky(p.lower, block, ordering);
  ASSERT_EQ(cholesky.factorize(p.values), -1);
  for (const std::size_t sides : {0, 2, 3, 7}) {
    std::vector<std::vector<double>> all(sides, std::vector<double>(usize(3 * width * width)));
    for (std::size_t k = 0; k < sides; ++k) {
      for (std::size_t i = 0; i < all[k].size(); ++i) all[k][i] = uniform2(k, i)[0] - 0.5;
    }
    std::vector<std::vector<double>> each = all;
    for (std::vector<double>& x : each) cholesky.solve(x);
    for (const int threads : {1, 3}) {
      std::vector<std::vector<double>> x = all;
      cholesky.solve(std::span(x), threads);
      EXPECT_EQ(x, each) << sides << " sides, " << threads << " threads";
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Nets, Supernodal,
                         testing::Combine(testing::Values(1, 2, 5, 17, 40), testing::Values(1, 3),
                                          testing::Values(Ordering::amd, Ordering::metis,
                                                          Ordering::natural)));

TEST(SupernodalCholesky, SaysWhereAMatrixIsNotPositiveDefiniteAndCanBeUsedAgain) {
  NetProblem p = net(12, 3);
  SupernodalCholesky cholesky(p.lower, 3);
  const std::vector<double> good = p.values;
  for (const double wrong : {-1.0, 0.0, std::nan("")}) {
    p.values = good;
    p.values[p.lower.start[100]] = wrong;  // a diagonal entry
    const std::int64_t row = cholesky.factorize(p.values);
    EXPECT_GE(row, 0);
    EXPECT_LT(row, p.lower.cols);
  }
  EXPECT_EQ(cholesky.factorize(good), -1);
}

TEST(SupernodalCholesky, TakesEmptyAndDisconnectedMatricesAndRefusesOthers) {
  SupernodalCholesky empty(SparsePattern{}, 3);
  EXPECT_EQ(empty.factorize({}), -1);
  const SparsePattern diagonal = build_pattern(3, 3, std::vector{std::pair(0, 0), {1, 1}, {2, 2}});
  SupernodalCholesky cholesky(diagonal, 1);
  EXPECT_EQ(cholesky.factorize(std::vector{4.0, 9.0, 16.0}), -1);
  std::vector<double> x = {4, 8, 12, 9, 18, 27, 16, 32, 48};
  cholesky.solve(x);
  EXPECT_EQ(x, (std::vector<double>{1, 2, 3, 1, 2, 3, 1, 2, 3}));
  const SparsePattern upper = build_pattern(2, 2, std::vector{std::pair(0, 0), {0, 1}, {1, 1}});
  EXPECT_THROW(SupernodalCholesky(upper, 1), InputError);
  EXPECT_THROW(SupernodalCholesky(diagonal, 2), InputError);
}

}  // namespace
}  // namespace substep
