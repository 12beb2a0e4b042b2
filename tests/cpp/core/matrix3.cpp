#include "substep/core/matrix3.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <limits>
#include <string>

#include "substep/core/random.h"

namespace {

using namespace substep;
using V = Vector<double>;
constexpr int kLanes = sizeof(V) / sizeof(double);

Eigen::Matrix3d eigen(const Matrix3<double>& A) {
  Eigen::Matrix3d B;
  for (int k = 0; k < 9; ++k) B(k / 3, k % 3) = A(k / 3, k % 3);
  return B;
}

// Random matrices, and those at which decompositions fail: equal columns, ranks 1 and 0, a
// reflection, the identity, tiny numbers.
Matrix3<double> sample(std::uint64_t index) {
  Matrix3<double> A{};
  for (int k = 0; k < 9; ++k) {
    A(k / 3, k % 3) = 2 * uniform2(7, 9 * index + static_cast<std::uint64_t>(k))[0] - 1;
  }
  switch (index % 8) {
    case 1:
      A.set_column(1, A.column(0));
      break;
    case 2:
      for (int j = 1; j < 3; ++j) A.set_column(j, (j + 1.0) * A.column(0));
      break;
    case 3:
      A = {};
      break;
    case 4:
      A = Matrix3<double>::identity();
      A(2, 2) = -1;
      break;
    case 5:
      A = combine(1e-40, A, 0.0, A);
      break;
    case 6:
      A = Matrix3<double>::identity();
      break;
    default:
      break;
  }
  return A;
}

double largest(const Eigen::Matrix3d& A) { return A.cwiseAbs().maxCoeff(); }

TEST(Matrix3, SingularValueDecomposition) {
  for (std::uint64_t index = 0; index < 4000; ++index) {
    SCOPED_TRACE("matrix " + std::to_string(index));
    const Matrix3<double> A = sample(index);
    const Svd3<double> svd = svd3(A);
    const Eigen::Matrix3d U = eigen(svd.U), W = eigen(svd.V);
    const Eigen::Vector3d s(svd.sigma[0], svd.sigma[1], svd.sigma[2]);
    const double size = largest(eigen(A));
    EXPECT_LE(largest(U * s.asDiagonal() * W.transpose() - eigen(A)), 1e-14 * size);
    EXPECT_LE(largest(U.transpose() * U - Eigen::Matrix3d::Identity()), 1e-14);
    EXPECT_LE(largest(W.transpose() * W - Eigen::Matrix3d::Identity()), 1e-14);
    EXPECT_GT(U.determinant(), 0);
    EXPECT_GT(W.determinant(), 0);
    const Eigen::Vector3d peer = Eigen::JacobiSVD<Eigen::Matrix3d>(eigen(A)).singularValues();
    EXPECT_LE((s.cwiseAbs() - peer).cwiseAbs().maxCoeff(), 1e-14 * size);
    EXPECT_GE(s[0], s[1]);
    EXPECT_GE(s[1], std::abs(s[2]) - 1e-15 * size);
  }
}

TEST(Matrix3, PositivePart) {
  for (std::uint64_t index = 0; index < 4000; ++index) {
    SCOPED_TRACE("matrix " + std::to_string(index));
    Matrix3<double> A = sample(index);
    A = combine(0.5, A, 0.5, transpose(A));
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> peer(eigen(A));
    const Eigen::Matrix3d expected = peer.eigenvectors() *
                                     peer.eigenvalues().cwiseMax(0).asDiagonal() *
                                     peer.eigenvectors().transpose();
    EXPECT_LE(largest(eigen(positive_part(A)) - expected), 1e-14 * largest(eigen(A)));
  }
}

TEST(Matrix3, LanesDoNotDependOnTheirNeighbours) {
  for (std::uint64_t index = 0; index < 500; ++index) {
    Matrix3<V> A;
    for (int lane = 0; lane < kLanes; ++lane) {
      const Matrix3<double> B = sample(3 * index + static_cast<std::uint64_t>(lane));
      for (int k = 0; k < 9; ++k) A(k / 3, k % 3)[lane] = B(k / 3, k % 3);
    }
    const Svd3<V> svd = svd3(A);
    for (int lane = 0; lane < kLanes; ++lane) {
      const Svd3<double> one = svd3(sample(3 * index + static_cast<std::uint64_t>(lane)));
      for (int k = 0; k < 9; ++k) {
        EXPECT_EQ(svd.U(k / 3, k % 3)[lane], one.U(k / 3, k % 3));
        EXPECT_EQ(svd.V(k / 3, k % 3)[lane], one.V(k / 3, k % 3));
      }
      for (int i = 0; i < 3; ++i) EXPECT_EQ(svd.sigma[i][lane], one.sigma[i]);
    }
  }
}

TEST(Matrix3, NaNEnds) {
  Matrix3<double> A = Matrix3<double>::identity();
  A(1, 1) = std::numeric_limits<double>::quiet_NaN();
  const Svd3<double> svd = svd3(A);
  EXPECT_TRUE(std::isnan(svd.sigma[0] + svd.sigma[1] + svd.sigma[2]));
}

}  // namespace
