// Principal axes of symmetric tensors against Eigen's in double precision, near and at repeated
// eigenvalues too; square roots and the exponential over lanes against those of the C library.
#include "substep/mpm/materials/principal.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <random>

#include "samples.h"
#include "substep/core/exp.h"

namespace {

using namespace substep;
using namespace substep::mpm;

template <class T>
class PrincipalAxes : public testing::Test {
 public:
  using V = Vector<T>;
#ifdef __FMA__
  static constexpr double kSingle = 2.5e-6;
#else
  static constexpr double kSingle = 4e-6;
#endif
  static constexpr double kTolerance = sizeof(T) == 8 ? 1e-13 : kSingle;  // of the largest d

  // Errors of one packet that has the same b in all lanes, by the largest eigenvalue.
  template <int D>
  static void check(const Matrix3d& exact) {
    SymmetricTensor<V, D> b[2];
    Matrix3d rounded = Matrix3d::Zero();
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        if (i < D && j < D) b[0](i, j) = splat<V>(static_cast<T>(exact(i, j)));
        rounded(i, j) = static_cast<T>(exact(i, j));
      }
    }
    b[0].m[2] = splat<V>(static_cast<T>(exact(2, 2)));
    b[1] = b[0];
    Principal<V, D> axes[2];
    principal_axes(b, axes);
    const Eigen::SelfAdjointEigenSolver<Matrix3d> reference(rounded);
    const double size = std::max(reference.eigenvalues().cwiseAbs().maxCoeff(), 1e-30);
    for (const Principal<V, D>& found : axes) {
      Eigen::Vector3d d(found.d[0][0], found.d[1][0], found.d[2][0]);
      Matrix3d U = Matrix3d::Identity();
      for (int k = 0; k < (D == 3 ? 9 : 2); ++k) U(k / 3, k % 3) = found.U[k][0];
      if (D == 2) U(1, 0) = -U(0, 1), U(1, 1) = U(0, 0);
      EXPECT_LT((U * d.asDiagonal() * U.transpose() - rounded).norm(), kTolerance * size);
      EXPECT_LT((U.transpose() * U - Matrix3d::Identity()).norm(), kTolerance);
      const V t[3] = {found.d[0], found.d[1], found.d[2]};
      EXPECT_LT((get(in_axes(found, t), 0) - rounded).norm(), kTolerance * size);
      std::sort(d.begin(), d.end());
      EXPECT_LT((d - reference.eigenvalues()).norm(), kTolerance * size);
    }
  }
};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(PrincipalAxes, Reals);

TYPED_TEST(PrincipalAxes, of_random_deformations) {
  std::mt19937 random(1);
  for (const double amplitude : {1e-6, 1e-3, 0.1, 0.5, 2.0}) {
    for (int trial = 0; trial < 4000; ++trial) {
      Matrix3d F = Matrix3d::Identity() + amplitude * random_matrix(random);
      this->template check<3>(F * F.transpose());
      F = Matrix3d::Identity() + amplitude * random_matrix(random, 2);
      this->template check<2>(F * F.transpose());
    }
  }
}

// Two and three equal eigenvalues, and nearly equal ones, in any frame.
TYPED_TEST(PrincipalAxes, of_repeated_eigenvalues) {
  std::mt19937 random(2);
  for (const double split : {0.0, 1e-14, 1e-10, 1e-7, 1e-5, 1e-3, 1e-2}) {
    for (const double third : {0.01, 0.5, 1.0, 1.001, 40.0}) {
      for (int trial = 0; trial < 200; ++trial) {
        const Eigen::Vector3d d(1, 1 + split, third);
        const Matrix3d Q = trial == 0 ? Matrix3d::Identity() : random_rotation(random);
        this->template check<3>(Q * d.asDiagonal() * Q.transpose());
        const Matrix3d R = trial == 0 ? Matrix3d::Identity() : random_rotation(random, 2);
        this->template check<2>(R * d.asDiagonal() * R.transpose());
      }
    }
  }
}

TYPED_TEST(PrincipalAxes, of_extreme_tensors) {
  std::mt19937 random(3);
  for (const double scale : {0.0, 1e-12, 1e-4, 1e4, 1e9}) {
    const Matrix3d A = scale * random_matrix(random);
    this->template check<3>(scale * Matrix3d::Identity());
    this->template check<3>(scale * Matrix3d::Ones());
    if (scale != 1e-12) this->template check<3>(A + A.transpose());
  }
}

TYPED_TEST(PrincipalAxes, of_nan_are_nan) {
  using Lanes = Vector<TypeParam>;
  for (int entry = 0; entry < 6; ++entry) {
    SymmetricTensor<Lanes, 3> b[1] = {};
    for (int i = 0; i < 3; ++i) b[0].m[i] = splat<Lanes>(1);
    b[0].m[entry][0] = std::numeric_limits<TypeParam>::quiet_NaN();
    Principal<Lanes, 3> axes[1];
    principal_axes(b, axes);
    const auto& d = axes[0].d;
    EXPECT_TRUE(std::isnan(d[0][0] + d[1][0] + d[2][0]));
    EXPECT_EQ(d[0][1], 1);
  }
}

template <class T>
class FunctionsOfLanes : public testing::Test {};
TYPED_TEST_SUITE(FunctionsOfLanes, Reals);

TYPED_TEST(FunctionsOfLanes, are_those_of_the_library) {
  using T = TypeParam;
  using V = Vector<T>;
  constexpr T kUnit = std::numeric_limits<T>::epsilon() / 2;  // half a unit in the last place
  constexpr T kBound = sizeof(T) == 8 ? T(708) : T(87);
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int trial = 0; trial < 100000; ++trial) {
    const T x = static_cast<T>(uniform(random) * (trial % 2 ? kBound : T(1)));
    const auto power = static_cast<T>(exp<V>(splat<V>(x))[0]);
    const long double exact = std::exp(static_cast<long double>(x));
    EXPECT_LT(std::abs(static_cast<double>(power / exact - 1)), 4 * kUnit) << x;
    const T a = static_cast<T>(std::exp(20 * uniform(random)));
    const long double root = std::sqrt(static_cast<long double>(a));
    EXPECT_EQ(sqrt<V>(splat<V>(a))[0], std::sqrt(a));
    EXPECT_LT(std::abs(static_cast<double>(inverse_root<V>(splat<V>(a))[0] * root - 1)), 4 * kUnit);
    EXPECT_LT(std::abs(static_cast<double>(inverse_sqrt_estimate<V>(splat<V>(a))[0] * root - 1)),
              4e-4);
  }
}

TYPED_TEST(FunctionsOfLanes, are_bounded) {
  using T = TypeParam;
  using V = Vector<T>;
  constexpr T kInfinity = std::numeric_limits<T>::infinity();
  const auto at = [](T x) { return static_cast<T>(exp<V>(splat<V>(x))[0]); };
  EXPECT_EQ(at(0), 1);
  EXPECT_TRUE(std::isnormal(at(kInfinity)) && at(kInfinity) > T(1e37));
  EXPECT_TRUE(std::isnormal(at(-kInfinity)) && at(-kInfinity) < T(1e-37));
  EXPECT_EQ(at(1000), at(kInfinity));
  EXPECT_TRUE(std::isnan(at(std::numeric_limits<T>::quiet_NaN())));
}

}  // namespace
