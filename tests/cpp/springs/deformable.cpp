#include "substep/springs/deformable.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <numbers>

#include "substep/core/errors.h"
#include "substep/springs/drag_term.h"
#include "substep/springs/spring_term.h"

namespace substep::springs {
namespace {

using geometry::Collider;
using geometry::Plane;

// Newton's method with a dense factorization, for a few vertices.
class DenseNewton : public Minimiser {
 public:
  explicit DenseNewton(int limit = 500) : limit_(limit) {}
  MinimiserReport minimise(IncrementalPotential& E, std::span<Vec3> x, double tolerance) override {
    MinimiserReport report;
    const std::size_t n = x.size();
    std::vector<Vec3> g(n), dx(n), trial(n);
    const BlockPattern& pattern = E.pattern();
    std::vector<double> values(pattern.rows.size());
    for (;; ++report.iterations) {
      E.assemble(x, 0.0, g, values);
      double largest = 0.0;
      for (const Vec3& part : g) largest = std::max(largest, part.cwiseAbs().maxCoeff());
      report.residuals.push_back(largest);
      report.converged = largest <= tolerance;
      if (report.converged || report.iterations == limit_) return report;
      Eigen::MatrixXd H = Eigen::MatrixXd::Zero(3 * n, 3 * n);
      for (std::size_t j = 0; j < 3 * n; ++j) {
        for (std::int32_t k = pattern.columns[j]; k < pattern.columns[j + 1]; ++k) {
          H(pattern.rows[k], j) = H(j, pattern.rows[k]) = values[k];
        }
      }
      Eigen::Map<Eigen::VectorXd>(dx[0].data(), 3 * n) =
          -H.ldlt().solve(Eigen::Map<const Eigen::VectorXd>(g[0].data(), 3 * n));
      const double start = E.energy(x);
      double s = E.step_bound(x, dx);
      for (;; s /= 2) {
        for (std::size_t i = 0; i < n; ++i) trial[i] = x[i] + s * dx[i];
        if (E.energy(trial) <= start || s < 1e-10) break;
      }
      std::copy(trial.begin(), trial.end(), x.begin());
    }
  }

 private:
  int limit_;
};

// A mass on a spring of rest length 1 along z from a pinned vertex.
struct Oscillator {
  static constexpr double kMass = 2.0, kStiffness = 18.0;  // omega = 3
  Springs springs{
      .vertices = {0, 1}, .stiffness = {kStiffness}, .rest_lengths = {1.0}, .damping = {}};

  std::unique_ptr<Deformable> body(Integrator integrator, double drag = 0.0) {
    const std::vector<Vec3> x = {Vec3::Zero(), {0.0, 0.0, 1.25}}, v(2, Vec3::Zero());
    const std::vector<double> masses = {1.0, kMass};
    std::vector<std::shared_ptr<Term>> terms = {
        std::make_shared<SpringTerm>(std::make_shared<const Springs>(springs))};
    if (drag > 0.0) terms.push_back(std::make_shared<DragTerm>(drag, masses));
    return std::make_unique<Deformable>(
        x, v, masses, std::vector<std::uint8_t>{1, 0}, terms, Contacts{},
        std::make_unique<DenseNewton>(),
        DeformableOptions{.integrator = integrator, .gravity = Vec3::Zero(), .tolerance = 1e-12});
  }
};

// One step of each integrator on x'' = -omega^2 x, in closed form, and the energy it makes of it.
TEST(Deformable, IntegratorsAreTheirFormulas) {
  const double h = 0.1, z = 0.3, a = -9.0 * 0.25;  // z = omega h
  const auto one = [&](Integrator integrator) {
    Oscillator oscillator;
    const auto body = oscillator.body(integrator);
    body->step(h);
    return std::pair(body->positions[1].z() - 1.0, body->velocities[1].z());
  };
  const auto expect = [&](Integrator integrator, double x, double v) {
    const auto [found_x, found_v] = one(integrator);
    EXPECT_NEAR(found_x, x, 1e-12);
    EXPECT_NEAR(found_v, v, 1e-11);
  };
  expect(Integrator::explicit_euler, 0.25, h * a);
  expect(Integrator::semi_implicit_euler, 0.25 + h * h * a, h * a);
  expect(Integrator::velocity_verlet, 0.25 + h * h * a / 2, h * a - h * 9.0 * h * h * a / 4);
  expect(Integrator::rk4, 0.25 * (1 - z * z / 2 + z * z * z * z / 24),
         -3.0 * 0.25 * (z - z * z * z / 6));
  expect(Integrator::implicit_euler, 0.25 / (1 + z * z), -9.0 * h * 0.25 / (1 + z * z));
}

TEST(Deformable, DragDecaysAsItsStepSays) {
  Oscillator oscillator;
  oscillator.springs.stiffness = {1e-12};
  const auto body = oscillator.body(Integrator::implicit_euler, 0.5);
  body->velocities[1] = {1.0, 0.0, 0.0};
  for (int k = 0; k < 10; ++k) body->step(0.1);
  EXPECT_NEAR(body->velocities[1].x(), std::pow(1.05, -10), 1e-9);
}

TEST(Deformable, SpectrumOfAChain) {
  constexpr int kMasses = 40;  // between two pins: omega = 2 sqrt(k/m) sin(pi n / (2 (n + 1)))
  Springs springs;
  std::vector<Vec3> x;
  std::vector<std::uint8_t> pinned(kMasses + 2, 0);
  pinned.front() = pinned.back() = 1;
  for (int i = 0; i <= kMasses; ++i) {
    springs.vertices.insert(springs.vertices.end(), {i, i + 1});
    springs.stiffness.push_back(50.0);
    springs.rest_lengths.push_back(1.0);
    springs.damping.push_back(3.0);
  }
  for (int i = 0; i < kMasses + 2; ++i) x.push_back({0.0, 0.0, 1.0 * i});
  const std::vector<double> masses(kMasses + 2, 0.5);
  IncrementalPotential potential(
      masses, pinned,
      {std::make_shared<SpringTerm>(std::make_shared<const Springs>(springs)),
       std::make_shared<SpringDampingTerm>(std::make_shared<const Springs>(springs))});
  const Spectrum found = largest_eigenvalues(potential, x);
  const double shape = 2 * std::sin(std::numbers::pi * kMasses / (2.0 * (kMasses + 1)));
  EXPECT_NEAR(found.frequency, shape * std::sqrt(50.0 / 0.5), 1e-6 * found.frequency);
  EXPECT_NEAR(found.damping_rate, shape * shape * 3.0 / 0.5, 1e-6 * found.damping_rate);
}

TEST(Deformable, PinsReachTheirTargets) {
  Oscillator oscillator;
  for (const Integrator integrator : {Integrator::velocity_verlet, Integrator::implicit_euler}) {
    const auto body = oscillator.body(integrator);
    body->targets[0] = {0.2, 0.0, 0.0};
    body->step(0.1);
    EXPECT_EQ(body->positions[0], Vec3(0.2, 0.0, 0.0));
    EXPECT_NEAR(body->velocities[0].x(), 2.0, 1e-14);
  }
}

TEST(Deformable, AFailedStepIsHalvedAndThenLeavesTheBodyAsItWas) {
  Oscillator oscillator;
  const std::vector<Vec3> x = {Vec3::Zero(), {0.0, 0.0, 1.25}}, v(2, Vec3(1.0, 0.0, 0.0));
  const auto body = [&](double tolerance) {
    return std::make_unique<Deformable>(
        x, v, std::vector<double>{1.0, 2.0}, std::vector<std::uint8_t>{1, 0},
        std::vector<std::shared_ptr<Term>>{
            std::make_shared<SpringTerm>(std::make_shared<const Springs>(oscillator.springs))},
        Contacts{}, std::make_unique<DenseNewton>(1),
        DeformableOptions{.tolerance = tolerance, .max_halvings = 6});
  };
  const auto halved = body(0.01);
  halved->step(0.1);
  EXPECT_GT(halved->report().failed, 0);
  EXPECT_TRUE(halved->report().converged);
  EXPECT_DOUBLE_EQ(halved->time, 0.1);
  const auto failed = body(0.0);
  EXPECT_THROW(failed->step(0.1), ConvergenceError);
  EXPECT_EQ(failed->positions, x);
  EXPECT_EQ(failed->velocities, v);
  EXPECT_EQ(failed->time, 0.0);
}

// A triangle of springs on an incline: it stays below the angle of friction and slides above, as a
// block would, and what it gives to the plane is its weight.
TEST(Deformable, SlipsAtTheAngleOfFriction) {
  constexpr double kFriction = 0.5, kStep = 1.0 / 120, kGravity = 9.81, kMass = 0.1;
  const double critical = std::atan(kFriction);
  for (const double offset : {-0.5, 0.5}) {
    const double angle = critical + offset * std::numbers::pi / 180;
    Collider plane(Plane{{std::sin(angle), 0.0, std::cos(angle)}}, Vec3::Zero());
    plane.friction = kFriction;
    const Vec3 down(std::cos(angle), 0.0, -std::sin(angle)),
        n(std::sin(angle), 0.0, std::cos(angle));
    const std::vector<Vec3> x = {5e-4 * n, 5e-4 * n + 0.1 * down, 5e-4 * n + Vec3(0.0, 0.1, 0.0)};
    const Springs springs{.vertices = {0, 1, 1, 2, 2, 0},
                          .stiffness = {1e3, 1e3, 1e3},
                          .rest_lengths = {0.1, 0.1 * std::numbers::sqrt2, 0.1},
                          .damping = {}};
    Deformable body(x, std::vector<Vec3>(3, Vec3::Zero()), std::vector<double>(3, kMass),
                    std::vector<std::uint8_t>(3, 0),
                    {std::make_shared<SpringTerm>(std::make_shared<const Springs>(springs))},
                    Contacts{.colliders = {plane}, .stiffness = {}},
                    std::make_unique<DenseNewton>(),
                    DeformableOptions{.tolerance = 1e-7 * kMass * kGravity});
    for (int k = 0; k < 240; ++k) {
      body.step(kStep);
      ASSERT_GT(closest_vertex(body.contacts, body.positions).distance, 0.0);
    }
    const double acceleration = kGravity * (std::sin(angle) - kFriction * std::cos(angle));
    const double speed = body.velocities[0].dot(down);
    if (offset > 0) {
      EXPECT_NEAR(speed, acceleration * 2.0, 0.05 * acceleration * 2.0);
    } else {
      EXPECT_LT(speed, 1e-3);  // the sticking speed
    }
    const Vec3 given = body.contacts.colliders[0].exchange().impulse / kStep;
    EXPECT_NEAR(-given.dot(n), 3 * kMass * kGravity * std::cos(angle), 1e-3);
  }
}

// A plane rises under a vertex and carries it.
TEST(Deformable, AMovingColliderPushes) {
  Collider plane(Plane{Vec3::UnitZ()}, Vec3::Zero());
  plane.velocity = {0.0, 0.0, 3.0};
  const std::vector<Vec3> x = {{0.0, 0.0, 0.01}}, v = {Vec3::Zero()};
  Deformable body(x, v, std::vector<double>{0.3}, std::vector<std::uint8_t>{0}, {},
                  Contacts{.colliders = {plane}, .stiffness = {}}, std::make_unique<DenseNewton>(),
                  DeformableOptions{.tolerance = 1e-9});
  for (int k = 0; k < 30; ++k) {
    body.step(1.0 / 60);
    ASSERT_GT(closest_vertex(body.contacts, body.positions).distance, 0.0);
  }
  EXPECT_NEAR(body.velocities[0].z(), 3.0, 1e-6);
}

}  // namespace
}  // namespace substep::springs
