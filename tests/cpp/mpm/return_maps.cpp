// Return maps against their closed forms in double precision, computed here from singular
// values alone.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "samples.h"

namespace {

using namespace substep;
using namespace substep::mpm;

template <class T>
class ReturnMaps : public testing::Test {
 public:
  static constexpr double kTolerance = sizeof(T) == 8 ? 1e-12 : 1e-5;
};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(ReturnMaps, Reals);

// One particle of snow, pressed along z a little each step: from the step that passes theta_c on,
// F_E stays at 1 - theta_c, J_P = det F / (1 - theta_c), and the stress grows by h(J_P) alone.
// Stomakhin et al. 2013, eqs. 1, 2, and section 7.
TYPED_TEST(ReturnMaps, snow_under_compression) {
  Packet<Snow, TypeParam> snow;
  const Snow& m = snow.material;
  const double G = -20, dt = 1e-4;  // 0.2 % each step
  double total = 1;                 // det F
  for (int step = 1; step <= 150; ++step) {
    total *= 1 + G * dt;
    snow.advance(diagonal(0, 0, G), dt);
    snow.stress(dt);
    const double s = std::max(total, 1 - m.critical_compression), J_P = total / s;
    const double h = std::exp(m.hardening * (1 - J_P));
    const double pressed = h * (2 * kMu * (s - 1) * s + kLambda * (s - 1) * s);
    const double sideways = h * kLambda * (s - 1) * s;
    // Rounding of F adds up over the steps.
    const double tolerance = TestFixture::kTolerance * 10;
    EXPECT_NEAR(snow.own(0), J_P, tolerance);
    EXPECT_NEAR(snow.F()(2, 2), s, tolerance);
    EXPECT_NEAR(snow.stress_of()(2, 2), pressed, tolerance * h * kLambda);
    EXPECT_NEAR(snow.stress_of()(0, 0), sideways, tolerance * h * kLambda);
  }
  EXPECT_LT(snow.own(0), 0.77);
}

// No answer where F_E has lost an axis.
TYPED_TEST(ReturnMaps, flat_snow_is_not_a_number) {
  Packet<Snow, TypeParam> snow;
  snow.deform(diagonal(1, 0.7, 0));
  snow.stress();
  EXPECT_FALSE(snow.stress_of().allFinite());
}

TYPED_TEST(ReturnMaps, snow_in_any_frame) {
  std::mt19937 random(1);
  for (int trial = 0; trial < 100; ++trial) {
    const Matrix3d F = Matrix3d::Identity() + 0.04 * random_matrix(random);
    Packet<Snow, TypeParam> snow;
    const Snow& m = snow.material;
    snow.deform(F);
    snow.stress();
    const Decomposed parts(F);
    const Vector3d s =
        parts.sigma().cwiseMax(1 - m.critical_compression).cwiseMin(1 + m.critical_stretch);
    const double J_P = parts.sigma().prod() / s.prod(), J = s.prod();
    const double h = std::exp(m.hardening * (1 - J_P));
    const Vector3d t = h * (2 * kMu * (s.array() - 1) * s.array() + kLambda * (J - 1) * J);
    EXPECT_NEAR(snow.own(0), J_P, TestFixture::kTolerance);
    EXPECT_LT((snow.F() - parts.deformation(s)).norm(), TestFixture::kTolerance);
    EXPECT_LT((snow.stress_of() - parts.tensor(t)).norm(), TestFixture::kTolerance * h * kLambda);
  }
}

// exp(xi (1 - J_P)) stays below largest_hardening, however hard or dense.
TYPED_TEST(ReturnMaps, snow_hardening_is_bounded) {
  for (const double xi : {0.0, 10.0, 1e3, 1e6}) {
    Packet<Snow, TypeParam> snow;
    snow.material.hardening = xi;
    for (int step = 0; step < 300; ++step) {
      snow.advance(diagonal(0, 0, -1000), 1e-4);
      snow.stress();
      EXPECT_TRUE(snow.stress_of().allFinite());
      EXPECT_LE(snow.modulus(), (kLambda + 2 * kMu) * snow.material.largest_hardening * 1.0001);
    }
    EXPECT_NEAR(snow.own(0), 1e-6, 1e-12);
    for (int step = 0; step < 600; ++step) {
      snow.advance(diagonal(0, 0, 1000), 1e-4);
      snow.stress();
      EXPECT_TRUE(snow.stress_of().allFinite());
    }
    EXPECT_LE(snow.own(0), 1e6);
    EXPECT_GT(snow.own(0), 1);
  }
}

// The projection of Klar et al. 2016 with v_c of Tampubolon et al. 2017.
struct SandReference {
  Vector3d eps;
  double v_c, q;
};
SandReference project_sand(const Vector3d& trial, double v_c, double alpha) {
  const Vector3d corrected = trial + Vector3d::Constant(v_c / 3);
  const double trace = corrected.sum();
  const Vector3d dev = corrected - Vector3d::Constant(trace / 3);
  const double over = dev.norm() + (3 * kLambda + 2 * kMu) / (2 * kMu) * trace * alpha;
  if (trace >= 0) return {Vector3d::Zero(), trace, trial.norm()};
  if (over <= 0) return {corrected, 0, 0};
  return {corrected - over * dev.normalized(), 0, over};
}
double alpha_of(double angle) {
  return std::sqrt(2.0 / 3) * 2 * std::sin(angle) / (3 - std::sin(angle));
}

TYPED_TEST(ReturnMaps, sand_in_any_frame) {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> uniform(0, 1);
  int seen[3] = {};
  for (int trial = 0; trial < 300; ++trial) {
    const Matrix3d F = (1 - 0.1 * (uniform(random) - 0.3)) * Matrix3d::Identity() +
                       0.1 * uniform(random) * random_matrix(random);
    const double v_c = trial % 3 == 0 ? 0.02 * uniform(random) : 0;
    Packet<Sand, TypeParam> sand;
    sand.deform(F);
    sand.fields[sand.kOwn] = splat<Vector<TypeParam>>(static_cast<TypeParam>(v_c));
    sand.stress();
    const Decomposed parts(F);
    const auto expected =
        project_sand(parts.sigma().array().log(), v_c, alpha_of(sand.material.friction_angle));
    const double tolerance = TestFixture::kTolerance;
    EXPECT_LT((sand.stress_of() - parts.tensor(hencky_stress(expected.eps))).norm(),
              tolerance * kLambda);
    EXPECT_LT((sand.F() - parts.deformation(expected.eps.array().exp())).norm(), tolerance);
    EXPECT_NEAR(sand.own(0), expected.v_c, tolerance);
    EXPECT_NEAR(sand.own(1), expected.q, tolerance);
    ++seen[expected.v_c > 0 ? 0 : (expected.q > 0 ? 1 : 2)];
  }
  for (const int count : seen) EXPECT_GT(count, 20);  // apex, cone, elastic
}

// On the cone |dev tau| = 3 alpha p: in triaxial compression that is Mohr and Coulomb's largest
// ratio of principal stresses, (1 + sin phi) / (1 - sin phi), and in plane strain with the other
// match the largest shear stress is p sin phi.
TYPED_TEST(ReturnMaps, sand_reaches_the_angle_of_friction) {
  for (const double degrees : {5.0, 20.0, 30.0, 42.0}) {
    const double sine = std::sin(degrees * std::numbers::pi / 180);
    Packet<Sand, TypeParam> sand;
    sand.material.friction_angle = degrees * std::numbers::pi / 180;
    sand.deform(diagonal(1.03, 1.03, 0.9));
    sand.stress();
    const Matrix3d tau = sand.stress_of();
    EXPECT_NEAR(tau(2, 2) / tau(0, 0), (1 + sine) / (1 - sine), 100 * TestFixture::kTolerance);
    EXPECT_NEAR(deviator(tau).norm(), 3 * alpha_of(sand.material.friction_angle) * pressure(tau),
                TestFixture::kTolerance * kLambda);

    Packet<Sand, TypeParam, 2> plane;
    plane.material.friction_angle = sand.material.friction_angle;
    plane.material.match = FrictionMatch::kPlaneStrain;
    plane.deform(diagonal(0.99, 0.99, 1));
    for (int step = 0; step < 400; ++step) {
      plane.advance(diagonal(1, -1, 0), 1e-3);
      plane.stress();
    }
    const Matrix3d sheared = plane.stress_of();
    const double shear = (sheared(0, 0) - sheared(1, 1)) / 2;
    const double mean = -(sheared(0, 0) + sheared(1, 1)) / 2;
    EXPECT_NEAR(shear / mean, sine, 1e-3);
  }
}

// Pulled apart, sand has no stress and remembers by how much; pushed together again it resists
// when the gap has closed, not before.
TYPED_TEST(ReturnMaps, sand_volume_correction) {
  Packet<Sand, TypeParam> sand;
  const double rate = 10, dt = 1e-3;  // 1 % each step
  for (int step = 0; step < 10; ++step) {
    sand.advance(diagonal(rate, rate, rate), dt);
    sand.stress();
    EXPECT_EQ(sand.stress_of().norm(), 0);
    EXPECT_NEAR(sand.own(0), 3 * (step + 1) * std::log1p(rate * dt), 30 * TestFixture::kTolerance);
    EXPECT_LT((sand.F() - Matrix3d::Identity()).norm(), 10 * TestFixture::kTolerance);
  }
  double open = sand.own(0);
  const double step_back = 3 * std::log1p(-rate * dt);
  while (open + step_back > 0) {
    open += step_back;
    sand.advance(diagonal(-rate, -rate, -rate), dt);
    sand.stress();
    EXPECT_EQ(sand.stress_of().norm(), 0);
    EXPECT_NEAR(sand.own(0), open, 30 * TestFixture::kTolerance);
  }
  sand.advance(diagonal(-rate, -rate, -rate), dt);
  sand.stress();
  const double strain = open + step_back;  // its trace, below 0
  EXPECT_NEAR(pressure(sand.stress_of()), -(kLambda + 2 * kMu / 3) * strain,
              100 * TestFixture::kTolerance * kLambda);
  EXPECT_EQ(sand.own(0), 0);
}

// phi = phi_0 + (h_1 q - h_3) exp(-h_2 q), read from the stress on the cone.
TYPED_TEST(ReturnMaps, sand_friction_hardens) {
  const double degree = std::numbers::pi / 180;
  Packet<Sand, TypeParam> sand;
  sand.material.friction_angle = 35 * degree;
  sand.material.hardening_slope = 9 * degree;
  sand.material.hardening_rate = 0.2;
  sand.material.initial_softening = 10 * degree;
  sand.deform(diagonal(0.98, 0.98, 0.98));
  for (int step = 0; step < 200; ++step) {
    const double q = sand.own(1);
    sand.advance(shear_rate(10), 1e-3);
    sand.stress();
    const Matrix3d tau = sand.stress_of();
    const double phi = (35 + (9 * q - 10) * std::exp(-0.2 * q)) * degree;
    if (sand.own(1) > q) {
      EXPECT_NEAR(deviator(tau).norm() / pressure(tau), 3 * alpha_of(phi),
                  100 * TestFixture::kTolerance);
    }
  }
  EXPECT_GT(sand.own(1), 0.5);
}

// Radial return (Simo and Hughes 1998, section 3.3).
TYPED_TEST(ReturnMaps, von_mises_in_any_frame) {
  std::mt19937 random(3);
  int yielded = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const double H = trial % 2 ? 5e3 : 0, a = trial % 4 < 2 ? 0 : 0.1;
    const Matrix3d F = Matrix3d::Identity() + (trial % 5 ? 0.1 : 0.01) * random_matrix(random);
    Packet<VonMises, TypeParam> body;
    body.material.hardening_modulus = H;
    body.deform(F);
    body.fields[body.kOwn] = splat<Vector<TypeParam>>(static_cast<TypeParam>(a));
    body.stress();
    const Decomposed parts(F);
    Vector3d eps = parts.sigma().array().log();
    const Vector3d dev = eps - Vector3d::Constant(eps.sum() / 3);
    const double limit = std::sqrt(2.0 / 3) * (body.material.yield_stress + H * a);
    const double dg = std::max(0.0, (2 * kMu * dev.norm() - limit) / (2 * kMu + 2 * H / 3));
    eps -= dg * dev.normalized();
    yielded += dg > 0;
    EXPECT_LT((body.stress_of() - parts.tensor(hencky_stress(eps))).norm(),
              TestFixture::kTolerance * kLambda);
    EXPECT_NEAR(body.own(0), a + std::sqrt(2.0 / 3) * dg, TestFixture::kTolerance);
    EXPECT_NEAR(std::log(body.F().determinant()), std::log(F.determinant()),
                TestFixture::kTolerance * 10);
    if (dg > 0) {
      EXPECT_NEAR(deviator(body.stress_of()).norm(),
                  std::sqrt(2.0 / 3) * (body.material.yield_stress + H * body.own(0)),
                  TestFixture::kTolerance * kLambda);
    }
  }
  EXPECT_GT(yielded, 100);
  EXPECT_LT(yielded, 200);
}

// A bar pulled at both ends flows at sigma_y + H a, sheared at sigma_y / sqrt(3).
TYPED_TEST(ReturnMaps, von_mises_yields_in_shear) {
  Packet<VonMises, TypeParam> body;
  for (int step = 0; step < 300; ++step) {
    body.advance(shear_rate(1), 1e-3);
    body.stress();
  }
  EXPECT_NEAR(body.stress_of()(0, 1), body.material.yield_stress / std::numbers::sqrt3,
              2e-3 * body.material.yield_stress);
}

// Fixed-corotated: 2 mu (F - R) F^T + lambda (J - 1) J I with R of the polar decomposition; the
// energy barrier is finite, so inverted F goes on, with the sign in the smallest stretch.
TYPED_TEST(ReturnMaps, fixed_corotated_is_that_of_the_polar_decomposition) {
  std::mt19937 random(4);
  int inverted = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const Matrix3d F = Matrix3d::Identity() + (trial % 2 ? 0.3 : 1.5) * random_matrix(random);
    Packet<FixedCorotated, TypeParam> body;
    body.deform(F);
    body.stress();
    const Decomposed parts(F);
    Vector3d sign = Vector3d::Ones();
    const double J = F.determinant();
    if (J < 0) sign[2] = -1, ++inverted;
    const Matrix3d R = parts.svd.matrixU() * sign.asDiagonal() * parts.svd.matrixV().transpose();
    const Matrix3d tau =
        2 * kMu * (F - R) * F.transpose() + kLambda * (J - 1) * J * Matrix3d::Identity();
    // Roots of eigenvalues: errors of the small ones grow where they nearly vanish.
    const double size = kLambda * std::max(1.0, F.squaredNorm() + J * J);
    EXPECT_LT((body.stress_of() - tau).norm(), (sizeof(TypeParam) == 8 ? 1e-8 : 1e-3) * size);
    EXPECT_NEAR(body.energy(), kMu * (F - R).squaredNorm() + kLambda / 2 * (J - 1) * (J - 1),
                (sizeof(TypeParam) == 8 ? 1e-8 : 1e-3) * size);
  }
  EXPECT_GT(inverted, 20);
}

// Its stress stays bounded without volume, in any frame.
TYPED_TEST(ReturnMaps, flat_fixed_corotated_is_finite) {
  std::mt19937 random(6);
  Packet<FixedCorotated, TypeParam> body;
  for (int lane = 0; lane < body.kLanes; ++lane) {
    body.deform(lane, random_rotation(random) * diagonal(1, 0.7, 0) * random_rotation(random));
  }
  body.stress();
  for (int lane = 0; lane < body.kLanes; ++lane) {
    EXPECT_TRUE(body.stress_of(lane).allFinite());
  }
}

}  // namespace
