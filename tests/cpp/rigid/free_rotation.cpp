// The free rotation against closed forms, against itself (composition, reversal) and against the
// equations of motion, integrated by small steps.
#include "substep/rigid/motion/free_rotation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "substep/rigid/motion/elliptic.h"

namespace {

using namespace substep;
using namespace substep::rigid;

double distance(const Quaternion& a, const Quaternion& b) {
  return std::min((a.coeffs() - b.coeffs()).norm(), (a.coeffs() + b.coeffs()).norm());
}
double energy(const Quaternion& q, const Vec3& L, const Vec3& I) {
  const Vec3 m = q.conjugate() * L;
  return 0.5 * m.cwiseQuotient(I).dot(m);
}

// The box of half extents 0.5, 0.25, 0.1 and mass 1 that spins about its middle axis.
const Vec3 kBox = Vec3(0.25 + 0.04, 1 + 0.04, 1 + 0.25) / 12;
const Vec3 kSpin = kBox.cwiseProduct(Vec3(0.01, 5, 0));

struct Case {
  Quaternion q;
  Vec3 L, I;
};

// Of all kinds: general, symmetric, nearly symmetric, spherical, close to the separatrix and to
// steady spins, fast and slow.
std::vector<Case> cases(int count) {
  std::mt19937 random(7);
  std::normal_distribution<> normal;
  std::uniform_real_distribution<> uniform(0, 1);
  const auto vector = [&] { return Vec3(normal(random), normal(random), normal(random)); };
  std::vector<Case> all;
  for (int i = 0; i < count; ++i) {
    Vec3 I(0.1 + uniform(random), 0.1 + uniform(random), 0.1 + uniform(random));
    if (i % 5 == 1) I[1] = I[0];
    if (i % 5 == 2) I[2] = I[0];
    if (i % 7 == 4) I[1] = I[2] * (1 + 1e-9 * uniform(random));
    if (i % 25 == 3) I.setConstant(0.7);
    Quaternion q = Quaternion(normal(random), normal(random), normal(random), normal(random));
    Vec3 L = vector();
    if (i % 11 == 0) {
      L *= std::pow(10, 7 * normal(random));
    } else if (i % 3 == 0) {
      q.setIdentity();
      L = std::pow(10, -2 - i % 7) * vector();
      L[i / 3 % 3] = 1;
    }
    all.push_back({q.normalized(), L, I});
  }
  return all;
}

TEST(Elliptic, JacobiAndCarlsonAreThoseOfTheTables) {
  // SciPy 1.15: ellipj(0.7, 0.3), ellipk(0.3); ellipj(3, 1 - 1e-6), ellipkm1(1e-6); elliprj.
  const Jacobi a = jacobi(0.7, 0.7), b = jacobi(3, 1e-6);
  EXPECT_NEAR(a.sn, 0.6323047763108646, 2e-16);
  EXPECT_NEAR(a.cn, 0.7747197363269298, 2e-16);
  EXPECT_NEAR(a.dn, 0.9381136396814304, 2e-16);
  EXPECT_NEAR(a.K, 1.713889448178791, 3e-16);
  EXPECT_NEAR(b.sn, 0.9950549950479006, 3e-16);
  EXPECT_NEAR(b.cn, 0.09932550946369463, 1e-15);
  EXPECT_NEAR(b.K, 8.294051463615439, 2e-15);
  EXPECT_NEAR(carlson_rj(0.2, 0.4, 1, 1.7), 1.335578770553713, 5e-16);
  EXPECT_NEAR(carlson_rj(0, 1e-12, 1, 17), 2.6241795005596122, 2e-15);
  EXPECT_NEAR(carlson_rj(0.99, 0.995, 1, 1e5), 2.9926935831025453e-05, 1e-20);
}

TEST(Elliptic, JacobiHasItsLimits) {
  for (const double u : {-40.0, -2.0, -1e-9, 0.0, 0.3, 5.0, 1000.0}) {
    const Jacobi circle = jacobi(u, 1);
    EXPECT_NEAR(circle.sn, std::sin(u), 1e-15);
    EXPECT_NEAR(circle.cn, std::cos(u), 1e-15);
    EXPECT_EQ(circle.dn, 1);
    EXPECT_DOUBLE_EQ(circle.K, 0.5 * std::numbers::pi);
  }
  for (const double u : {-9.0, -0.5, 1e-12, 3.0, 12.0}) {
    const Jacobi separatrix = jacobi(u, 1e-32);
    EXPECT_NEAR(separatrix.sn, std::tanh(u), 1e-15);
    EXPECT_NEAR(separatrix.cn * std::cosh(u), 1, 1e-11);
    EXPECT_NEAR(separatrix.dn * std::cosh(u), 1, 1e-11);
  }
}

TEST(ExactRotation, ComposesAndReverses) {
  int i = 0;
  for (const auto& [q, L, I] : cases(3000)) {
    // Up to 30 revolutions in one go and 3 in the other.
    const double unit = I.minCoeff() / L.norm(), a = (i++ % 2 ? 2.7 : 27) * unit, b = 1.9 * unit;
    const Quaternion there = exact_rotation(q, L, I, a);
    EXPECT_LT(distance(exact_rotation(there, L, I, b), exact_rotation(q, L, I, a + b)), 1e-13);
    EXPECT_LT(distance(exact_rotation(there, L, I, -a), q), 1e-10);  // instability amplifies
    Quaternion steps = q;
    for (int k = 0; k < 20; ++k) steps = exact_rotation(steps, L, I, a / 20);
    EXPECT_LT(distance(steps, there), 1e-10) << I.transpose() << " L " << L.transpose();
    EXPECT_NEAR(energy(there, L, I) / energy(q, L, I), 1, 1e-14);
  }
}

TEST(ExactRotation, SolvesTheEquationsOfMotion) {
  // Simpson's rule of Runge and Kutta on q' = w q / 2, w = R (m / I): error 1e-11 with 4000 steps.
  const auto rate = [](const Eigen::Vector4d& y, const Vec3& L, const Vec3& I) {
    const Quaternion q(y);
    const Vec3 w = (q.conjugate() * L).cwiseQuotient(I);
    return Eigen::Vector4d(0.5 * (q * Quaternion(0, w[0], w[1], w[2])).coeffs());
  };
  for (const auto& [q, L, I] : cases(60)) {
    const double dt = 4 * I.minCoeff() / L.norm(), h = dt / 4000;
    Eigen::Vector4d y = q.coeffs();
    for (int k = 0; k < 4000; ++k) {
      const Eigen::Vector4d k1 = rate(y, L, I), k2 = rate(y + h / 2 * k1, L, I),
                            k3 = rate(y + h / 2 * k2, L, I), k4 = rate(y + h * k3, L, I);
      y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    }
    EXPECT_LT(distance(exact_rotation(q, L, I, dt), Quaternion(y)), 1e-11);
  }
}

TEST(ExactRotation, OfASymmetricTopIsAPrecessionAboutLAndASpin) {
  // Euler: R = exp(t L / I1) R0 exp(t (I1 - I3) / I1 w3 e_3).
  const double I1 = 0.3;
  for (const double I3 : {0.05, 0.3 - 1e-12, 0.3, 0.35, 0.6}) {
    const Vec3 I(I1, I1, I3), L(0.2, -0.4, 1.3);
    const Quaternion q = rotation_by({0.3, 1.2, -0.7});
    const double spin = (q.conjugate() * L)[2] / I3;
    Quaternion steps = q;
    for (int k = 1; k <= 24000; ++k) steps = exact_rotation(steps, L, I, 1. / 240);
    const Quaternion closed =
        rotation_by(100 / I1 * L) * q * rotation_by({0, 0, 100 * (I1 - I3) / I1 * spin});
    EXPECT_LT(distance(steps, closed), 1e-10);
    EXPECT_LT(distance(exact_rotation(q, L, I, 100), closed), 1e-12);
    EXPECT_LT(distance(splitting_rotation(q, L, I, 100), closed), 1e-12);
  }
}

TEST(ExactRotation, TumblesForAHundredSeconds) {
  Quaternion q = Quaternion::Identity();
  const double T = energy(q, kSpin, kBox);
  // Times at which the middle component of m changes its sign: 2.269436, 6.808308, 11.347181,
  // 15.886053 s by an integration with tolerance 1e-12, every 4.538872 s; 22 in 100 s.
  std::vector<double> flips;
  const auto middle = [](const Quaternion& at) { return (at.conjugate() * kSpin)[1]; };
  for (int k = 0; k < 24000; ++k) {
    const Quaternion next = exact_rotation(q, kSpin, kBox, 1. / 240);
    EXPECT_NEAR(energy(next, kSpin, kBox) / T, 1, 1e-12);
    if (middle(q) * middle(next) < 0) {
      double low = 0, high = 1. / 240;
      while (high - low > 1e-9) {
        const double half = 0.5 * (low + high);
        (middle(exact_rotation(q, kSpin, kBox, half)) * middle(q) > 0 ? low : high) = half;
      }
      flips.push_back(k / 240. + low);
    }
    q = next;
  }
  ASSERT_EQ(flips.size(), 22u);
  const double published[] = {2.269436, 6.808308, 11.347181, 15.886053};
  for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(flips[i], published[i], 1e-6);
  for (std::size_t i = 1; i < 22; ++i) EXPECT_NEAR(flips[i] - flips[i - 1], 4.538872, 1e-6);
}

TEST(ExactRotation, DoesNotDriftInAMillionSteps) {
  Quaternion q = Quaternion::Identity();
  const double T = energy(q, kSpin, kBox);
  double worst = 0;
  for (int k = 0; k < 1000000; ++k) {
    q = exact_rotation(q, kSpin, kBox, 1. / 240);
    if (k % 1000 == 0) worst = std::max(worst, std::abs(energy(q, kSpin, kBox) / T - 1));
  }
  EXPECT_LT(worst, 5e-12);
  EXPECT_NEAR(q.norm(), 1, 1e-15);
}

TEST(ExactRotation, TakesExtremes) {
  const Quaternion q = rotation_by({0.1, 0.2, 0.3});
  EXPECT_EQ(distance(exact_rotation(q, Vec3::Zero(), kBox, 1), q), 0);
  EXPECT_EQ(distance(exact_rotation(q, kSpin, kBox, 0), q), 0);
  // A million rad/s, 5000 rad a step: the energy is kept, and the steps compose.
  const Vec3 fast = kBox.cwiseProduct(Vec3(3e5, 1e6, 2e5));
  const Quaternion after = exact_rotation(q, fast, kBox, 1. / 200);
  EXPECT_NEAR(energy(after, fast, kBox) / energy(q, fast, kBox), 1, 1e-11);
  Quaternion steps = q;
  for (int k = 0; k < 100; ++k) steps = exact_rotation(steps, fast, kBox, 1. / 20000);
  EXPECT_LT(distance(steps, after), 1e-9);
  // Slow and light to the end of the numbers.
  for (const double scale : {1e-300, 1e-200, 1e-30, 1e30, 1e200}) {
    const Vec3 L = scale * kSpin;
    const Quaternion same = exact_rotation(q, L, kBox, 0.5 / scale);
    EXPECT_LT(distance(same, exact_rotation(q, kSpin, kBox, 0.5)), 1e-14) << scale;
  }
  // A spin about a principal axis stays there, about the unstable one too.
  for (int i = 0; i < 3; ++i) {
    Vec3 L = Vec3::Zero();
    L[i] = 2;
    const Quaternion once = exact_rotation(Quaternion::Identity(), L, kBox, 1e3);
    EXPECT_LT(distance(once, rotation_by(1e3 / kBox[i] * L)), 1e-11);
  }
}

TEST(SplittingRotation, KeepsTheEnergyWithinABoundAndReverses) {
  Quaternion q = Quaternion::Identity();
  const double T = energy(q, kSpin, kBox);
  double first = 0, last = 0;
  for (int k = 0; k < 240000; ++k) {
    q = splitting_rotation(q, kSpin, kBox, 1. / 240);
    const double error = std::abs(energy(q, kSpin, kBox) / T - 1);
    double& worst = k < 24000 ? first : last;
    worst = std::max(worst, error);
  }
  EXPECT_LT(first, 1e-5);
  EXPECT_LT(last, 1.001 * first);
  const Quaternion there = splitting_rotation(q, kSpin, kBox, 0.1);
  EXPECT_LT(distance(splitting_rotation(there, kSpin, kBox, -0.1), q), 1e-15);
}

TEST(SplittingRotation, OfABodyDependsOnNoOther) {
  const std::vector<Case> all = cases(53);  // whole packets and a rest
  std::vector<double> q, L, I;
  for (const Case& one : all) {
    q.insert(q.end(), {one.q.w(), one.q.x(), one.q.y(), one.q.z()});
    L.insert(L.end(), one.L.begin(), one.L.end());
    I.insert(I.end(), one.I.begin(), one.I.end());
  }
  splitting_rows(53, q.data(), L.data(), I.data(), 0.05);
  for (std::size_t i = 0; i < all.size(); ++i)
    EXPECT_EQ(splitting_rotation(all[i].q, all[i].L, all[i].I, 0.05).coeffs(),
              load_quaternion(&q[4 * i]).coeffs());
  // At rest nothing changes; NaN stays in its row.
  const Vec3 zero = Vec3::Zero();
  EXPECT_EQ(splitting_rotation(all[0].q, zero, kBox, 0.05).coeffs(), all[0].q.coeffs());
  L[3 * 17] = std::nan("");
  splitting_rows(53, q.data(), L.data(), I.data(), 0.05);
  for (std::size_t i = 0; i < all.size(); ++i) EXPECT_EQ(std::isnan(q[4 * i]), i == 17);
}

// The order at which the four choices converge to the exact one.
TEST(FreeRotation, ConvergesWithItsOrder) {
  const Quaternion q = rotation_by({0.1, 0.2, 0.3});
  const Vec3 L(0.1, 0.3, -0.2), I(0.2, 0.3, 0.4);
  const Quaternion exact = exact_rotation(q, L, I, 1);
  const auto error = [&](FreeRotation method, int steps) {
    double row[4];
    store_quaternion(q, row);
    rotate_freely(method, 1, row, L.data(), I.data(), 1.0 / steps, steps);
    return distance(load_quaternion(row), exact);
  };
  EXPECT_NEAR(std::log2(error(FreeRotation::kSplitting, 40) / error(FreeRotation::kSplitting, 80)),
              2, 0.05);
  for (const auto method : {FreeRotation::kQuaternion, FreeRotation::kMatrix})
    EXPECT_NEAR(std::log2(error(method, 400) / error(method, 800)), 1, 0.05);
  EXPECT_LT(error(FreeRotation::kExact, 7), 1e-15);
}

TEST(FreeRotation, HasTheSameBitsForAnyNumberOfThreads) {
  const std::vector<Case> all = cases(5000);
  std::vector<double> start, L, I;
  for (const Case& one : all) {
    start.insert(start.end(), {one.q.w(), one.q.x(), one.q.y(), one.q.z()});
    L.insert(L.end(), one.L.begin(), one.L.end());
    I.insert(I.end(), one.I.begin(), one.I.end());
  }
  for (const auto method : {FreeRotation::kExact, FreeRotation::kSplitting,
                            FreeRotation::kQuaternion, FreeRotation::kMatrix}) {
    std::vector<double> q1 = start, q3 = start;
    rotate_freely(method, 5000, q1.data(), L.data(), I.data(), 0.01, 2, 1);
    rotate_freely(method, 5000, q3.data(), L.data(), I.data(), 0.01, 2, 3);
    EXPECT_EQ(q1, q3);
    EXPECT_NE(q1, start);
  }
}

TEST(Rotation, ExponentialAndLogarithmAreInverse) {
  for (const double angle : {0.0, 1e-9, 9e-5, 1.1e-4, 0.7, 3.1}) {
    const Vec3 a = angle * Vec3(2, -1, 2) / 3;
    EXPECT_LT((rotation_vector(rotation_by(a)) - a).norm(), 1e-15);
    const Quaternion q = rotation_by(a);
    EXPECT_LT((rotation_vector(Quaternion(-q.coeffs())) - a).norm(), 1e-15);
    EXPECT_LT((q.toRotationMatrix() - Eigen::AngleAxisd(angle, Vec3(2, -1, 2) / 3).matrix()).norm(),
              1e-15);
  }
}

}  // namespace
