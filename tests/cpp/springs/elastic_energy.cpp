#include "substep/springs/elastic_energy.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Jacobi>

#include "substep/core/random.h"

namespace {

using namespace substep;
using namespace substep::springs;
using Matrix9 = Eigen::Matrix<double, 9, 9>;
constexpr Lame<double> kLame{1.3, 2.1};

Matrix3<double> random_matrix(std::uint64_t index) {
  Matrix3<double> F;
  for (int k = 0; k < 9; ++k) {
    F(k / 3, k % 3) = 3 * uniform2(11, 9 * index + static_cast<std::uint64_t>(k))[0] - 1.5;
  }
  return F;
}

// Random F (half of them inverted), rotations, reflections, rank 2, 1 and 0, and rest.
Matrix3<double> deformation(std::uint64_t index) {
  Matrix3<double> F = random_matrix(index);
  switch (index % 8) {
    case 1:
      return svd3(F).U;
    case 2:
      F = svd3(F).U;
      F.set_column(2, -1.0 * F.column(2));
      return F;
    case 3:
      F.set_column(2, {{0, 0, 0}});
      return F;
    case 4:
      F.set_column(1, 2.0 * F.column(0));
      F.set_column(2, -1.0 * F.column(0));
      return F;
    case 5:
      return {};
    case 6:
      return Matrix3<double>::identity();
    default:
      return F;
  }
}

// d2Psi/dF2 from its frame, rows and columns 3 i + j for F_ij.
Matrix9 hessian(const Svd3<double>& svd, const PrincipalCurvature<double>& H) {
  Matrix9 out;
  for (int j = 0; j < 3; ++j) {
    for (int l = 0; l < 3; ++l) {
      Vector3<double> g{}, h{};
      g[j] = h[l] = 1;
      const Matrix3<double> K =
          svd.U * principal_block(H, transpose(svd.V) * g, transpose(svd.V) * h) * transpose(svd.U);
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) out(3 * i + j, 3 * k + l) = K(i, k);
      }
    }
  }
  return out;
}

// The positive part by Jacobi's rotations.
Matrix9 positive_part_of(const Matrix9& symmetric) {
  Matrix9 D = symmetric, W = Matrix9::Identity(), P = Matrix9::Zero();
  for (int sweep = 0; sweep < 12; ++sweep) {
    for (int q = 1; q < 9; ++q) {
      for (int p = 0; p < q; ++p) {
        Eigen::JacobiRotation<double> rotation;
        rotation.makeJacobi(D, p, q);
        D.applyOnTheLeft(p, q, rotation.adjoint());
        D.applyOnTheRight(p, q, rotation);
        W.applyOnTheRight(p, q, rotation);
      }
    }
  }
  for (int k = 0; k < 9; ++k) {
    P += std::max(D(k, k), 0.0) * W.col(k).lazyProduct(W.col(k).transpose());
  }
  return P;
}

template <class Model>
class ElasticEnergy : public testing::Test {};
using Models = testing::Types<StableNeoHookean, StVenantKirchhoff>;
TYPED_TEST_SUITE(ElasticEnergy, Models);

TYPED_TEST(ElasticEnergy, DerivativesAreThoseOfFiniteDifferences) {
  constexpr double h = 1e-5;
  for (std::uint64_t index = 0; index < 800; ++index) {
    SCOPED_TRACE("deformation " + std::to_string(index));
    const Matrix3<double> F = deformation(index), P = TypeParam::stress(F, kLame);
    Matrix9 expected;
    for (int k = 0; k < 9; ++k) {
      Matrix3<double> plus = F, minus = F;
      plus(k / 3, k % 3) += h;
      minus(k / 3, k % 3) -= h;
      const double slope =
          (TypeParam::energy(plus, kLame) - TypeParam::energy(minus, kLame)) / (2 * h);
      EXPECT_NEAR(P(k / 3, k % 3), slope, 3e-8);
      const Matrix3<double> rise = combine(0.5 / h, TypeParam::stress(plus, kLame), -0.5 / h,
                                           TypeParam::stress(minus, kLame));
      for (int l = 0; l < 9; ++l) expected(l, k) = rise(l / 3, l % 3);
    }
    const Svd3<double> svd = svd3(F);
    const PrincipalCurvature<double> H = TypeParam::curvature(svd.sigma, kLame);
    EXPECT_LE((hessian(svd, H) - expected).cwiseAbs().maxCoeff(), 3e-8);

    const Matrix9 positive = positive_part_of(0.5 * (expected + expected.transpose()));
    EXPECT_LE((hessian(svd, filter(H, 0.0)) - positive).cwiseAbs().maxCoeff(), 3e-8);
    const Matrix9 quarter = 0.75 * positive + 0.25 * expected;
    EXPECT_LE((hessian(svd, filter(H, 0.25)) - quarter).cwiseAbs().maxCoeff(), 3e-8);
  }
}

TYPED_TEST(ElasticEnergy, IsLinearElasticityAtRest) {
  const Svd3<double> rest = svd3(Matrix3<double>::identity());
  const Matrix9 H = hessian(rest, TypeParam::curvature(rest.sigma, kLame));
  for (int k = 0; k < 9; ++k) {
    for (int l = 0; l < 9; ++l) {
      const int i = k / 3, j = k % 3, m = l / 3, n = l % 3;
      const double expected =
          kLame.mu * ((i == m && j == n) + (i == n && j == m)) + kLame.lambda * (i == j && m == n);
      EXPECT_NEAR(H(k, l), expected, 1e-14);
    }
  }
  const Matrix3<double> P = TypeParam::stress(Matrix3<double>::identity(), kLame);
  for (int k = 0; k < 9; ++k) EXPECT_NEAR(P(k / 3, k % 3), 0, 1e-15);
  EXPECT_EQ(TypeParam::energy(Matrix3<double>::identity(), kLame), 0);
}

TYPED_TEST(ElasticEnergy, IsInvariantUnderRotation) {
  for (std::uint64_t index = 0; index < 80; ++index) {
    const Matrix3<double> F = deformation(index), R = svd3(random_matrix(1000 + index)).U;
    const double scale = 1 + std::abs(TypeParam::energy(F, kLame));
    EXPECT_NEAR(TypeParam::energy(R * F, kLame), TypeParam::energy(F, kLame), 1e-14 * scale);
    const Matrix3<double> P = TypeParam::stress(R * F, kLame), RP = R * TypeParam::stress(F, kLame);
    for (int k = 0; k < 9; ++k) EXPECT_NEAR(P(k / 3, k % 3), RP(k / 3, k % 3), 1e-13 * scale);
  }
}

TEST(ElasticEnergy, CollapseIsNoRestOfTheStableNeoHookean) {
  // Along F = s 1 the energy falls all the way from the collapse, and the reflection, to rest.
  double last = StableNeoHookean::energy(
      combine(-1.01, Matrix3<double>::identity(), 0.0, Matrix3<double>::identity()), kLame);
  for (int k = -100; k <= 100; ++k) {
    const Matrix3<double> F =
        combine(0.01 * k, Matrix3<double>::identity(), 0.0, Matrix3<double>::identity());
    const double energy = StableNeoHookean::energy(F, kLame);
    EXPECT_LT(energy, last);
    last = energy;
  }
}

}  // namespace
