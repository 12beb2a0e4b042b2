#include "substep/springs/bordered_cholesky.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <tuple>
#include <vector>

#include "substep/core/random.h"
#include "substep/core/usize.h"

namespace substep::springs {
namespace {

// A chain of vertices, of which a body pushes each, or so many that are `apart`, along z by
// contacts of this stiffness, with unknowns that move it by `motion` of theirs; and a body that
// nothing touches.
struct Chain {
  SparsePattern lower;
  std::vector<double> values;
  Border border;
  Eigen::MatrixXd dense;
  Chain(std::int32_t vertices, double contact, double motion, double inertia,
        std::int32_t touched = INT32_MAX, std::int32_t apart = 1) {
    const std::int32_t n = 3 * vertices;
    const auto pushing_at = [&](std::int32_t i) -> Mat3 {
      const bool touches = i % apart == 0 && i / apart < touched;
      return Vec3(0, 0, touches ? contact : 0.0).asDiagonal();
    };
    lower.rows = lower.cols = n;
    lower.start.clear();
    for (std::int32_t i = 0; i < vertices; ++i) {
      const Mat3 pushing = pushing_at(i);
      for (std::int32_t c = 0; c < 3; ++c) {
        lower.start.push_back(static_cast<std::int32_t>(lower.row.size()));
        for (std::int32_t r = c; r < 3; ++r) {
          lower.row.push_back(3 * i + r);
          values.push_back((r == c ? 2.1 : 0.0) + pushing(r, c));
        }
        for (std::int32_t r = 0; r < 3 && i + 1 < vertices; ++r) {
          lower.row.push_back(3 * i + 3 + r);
          values.push_back(r == c ? -1.0 : 0.0);
        }
      }
    }
    lower.start.push_back(static_cast<std::int32_t>(lower.row.size()));
    border.touches.resize(2);
    border.corners.assign(2, inertia * Mat6::Identity());
    for (std::int32_t i = 0; i < vertices; ++i) {
      const Mat3 pushing = pushing_at(i);
      if (pushing.isZero(0.0)) continue;
      Mat36 by = Mat36::Zero();
      by.leftCols<3>().setIdentity();
      by(2, 4) = 0.1 * (i - vertices / 2);
      by *= motion;
      border.touches[1].push_back({i, -pushing * by});
      border.corners[1] += by.transpose() * pushing * by;
    }
    dense = Eigen::MatrixXd::Zero(n + 12, n + 12);
    for (std::int32_t c = 0; c < n; ++c) {
      for (std::int32_t k = lower.start[usize(c)]; k < lower.start[usize(c) + 1]; ++k) {
        dense(lower.row[usize(k)], c) = dense(c, lower.row[usize(k)]) = values[usize(k)];
      }
    }
    for (int b = 0; b < 2; ++b) {
      dense.block<6, 6>(n + 6 * b, n + 6 * b) = border.corners[usize(b)];
      for (const Border::Touch& touch : border.touches[usize(b)]) {
        dense.block<3, 6>(3 * touch.vertex, n + 6 * b) = touch.block;
        dense.block<6, 3>(n + 6 * b, 3 * touch.vertex) = touch.block.transpose();
      }
    }
  }
};

// Heavy bodies move little by their unknowns; a light one is known by its contacts but for a
// difference beyond float32. Two vertices are neighbours; six that are apart are none.
TEST(BorderedCholesky, SolvesForHeavyAndForLightBodiesWithTheSameBitsForAnyNumberOfThreads) {
  for (const auto& [contact, motion, inertia, touched, apart] : {std::tuple{1e3, 0.01, 1.0, 50, 1},
                                                                 {1e3, 1.0, 1.0, 50, 1},
                                                                 {1e6, 1.0, 1e-4, 50, 1},
                                                                 {1e3, 1.0, 1.0, 2, 1},
                                                                 {1e3, 1.0, 1e-4, 2, 1},
                                                                 {1e3, 0.01, 1.0, 6, 3},
                                                                 {1e3, 1.0, 1.0, 6, 3},
                                                                 {1e6, 1.0, 1e-4, 6, 3}}) {
    const Chain chain(50, contact, motion, inertia, touched, apart);
    std::vector<double> b(usize(chain.dense.rows())), first;
    for (std::size_t i = 0; i < b.size(); ++i) b[i] = uniform2(3, i)[0] - 0.5;
    for (const int threads : {1, 2, 3}) {
      BorderedCholesky cholesky(chain.lower);
      ASSERT_TRUE(cholesky.factorize(chain.values, chain.border, threads));
      std::vector<double> x = b;
      ASSERT_TRUE(cholesky.solve(chain.values, chain.border, x, 1e-6, threads));
      const Eigen::Map<const Eigen::VectorXd> right(b.data(), chain.dense.rows());
      const Eigen::Map<const Eigen::VectorXd> found(x.data(), chain.dense.rows());
      EXPECT_LT((right - chain.dense * found).norm(), 1e-5 * right.norm()) << contact;
      if (threads == 1) first = x;
      EXPECT_EQ(first, x) << threads << " threads";
    }
  }
}

TEST(BorderedCholesky, SaysWhereTheMatrixIsNotPositiveDefinite) {
  Chain chain(10, 10.0, 1.0, 1.0);
  BorderedCholesky cholesky(chain.lower);
  EXPECT_TRUE(cholesky.factorize(chain.values, chain.border, 1));
  chain.border.corners[1](2, 2) -= 100.0;
  EXPECT_FALSE(cholesky.factorize(chain.values, chain.border, 1));
  chain.border.corners[1](2, 2) += 100.0;
  chain.values[0] = -1.0;
  EXPECT_FALSE(cholesky.factorize(chain.values, chain.border, 1));
}

}  // namespace
}  // namespace substep::springs
