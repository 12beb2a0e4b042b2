#include "substep/springs/contact.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <utility>

#include "substep/core/usize.h"
#include "substep/springs/incremental_potential.h"

namespace substep::springs {
namespace {

using geometry::Collider;
using geometry::Plane;
using geometry::Sphere;

Contacts contacts_with(Collider collider, std::size_t vertices, double friction = 0.0) {
  collider.friction = friction;
  return {.colliders = {collider},
          .stiffness = std::vector<double>(vertices, 7.0),
          .thickness = 0.1,
          .sticking_speed = 0.05};
}

// Central differences of energy and gradient of a term against what it says of itself.
void expect_derivatives(Term&& term, const std::vector<Vec3>& at) {
  term.find(at);
  const std::int64_t n = element_count(term);
  std::vector<Vec3> g(usize(n)), up(g), down(g);
  std::vector<Mat3> H(usize(n));
  term.derivatives(at, 0, n, 1.0, g.data(), H.data());
  constexpr double kStep = 1e-6;
  for (std::int64_t e = 0; e < n; ++e) {
    const std::int32_t i = term.vertices()[e];
    for (int c = 0; c < 3; ++c) {
      std::vector<Vec3> plus = at, minus = at;
      plus[i][c] += kStep;
      minus[i][c] -= kStep;
      const double slope =
          (term.energy(plus, e, e + 1) - term.energy(minus, e, e + 1)) / (2 * kStep);
      EXPECT_NEAR(g[e][c], slope, 1e-7 * (1 + std::abs(slope))) << e << ' ' << c;
      term.derivatives(plus, e, e + 1, 1.0, &up[e], nullptr);
      term.derivatives(minus, e, e + 1, 1.0, &down[e], nullptr);
      const Vec3 column = (up[e] - down[e]) / (2 * kStep);
      EXPECT_LT((H[e].col(c) - column).norm(), 1e-5 * (1 + column.norm())) << e << ' ' << c;
    }
  }
}

TEST(Contact, BarrierDerivatives) {
  const std::vector<Vec3> at = {{0.3, 0.2, 0.05}, {1.0, 0.0, 0.002}, {0.0, 0.0, 0.2}};
  const Contacts plane = contacts_with(Collider(Plane{Vec3::UnitZ()}, Vec3::Zero()), 3);
  expect_derivatives(BarrierTerm(plane), at);
  const std::vector<Vec3> around = {{0.62, 0.83, 0.05}, {0.0, -1.03, 0.0}, {0.0, 0.0, 2.0}};
  const Contacts sphere = contacts_with(Collider(Sphere{1.0}, Vec3::Zero()), 3);
  expect_derivatives(BarrierTerm(sphere), around);
  const std::vector<Vec3> inside = {{0.5, 0.8, 0.05}, {0.0, -0.97, 0.0}, {0.0, 0.0, 0.2}};
  const Contacts shell = contacts_with(Collider(Sphere{1.0}, Vec3::Zero(), true), 3);
  expect_derivatives(BarrierTerm(shell), inside);
}

TEST(Contact, BarrierVanishesSmoothlyAtItsThickness) {
  const Contacts plane = contacts_with(Collider(Plane{Vec3::UnitZ()}, Vec3::Zero()), 1);
  BarrierTerm term(plane);
  const std::vector<Vec3> at = {{0.0, 0.0, 0.1 - 1e-7}};
  term.find(at);
  Vec3 g;
  Mat3 H;
  term.derivatives(at, 0, 1, 1.0, &g, &H);
  EXPECT_LT(g.norm(), 1e-11);
  EXPECT_LT(H.norm(), 1e-3);
  EXPECT_EQ(term.energy(std::vector<Vec3>{{0.0, 0.0, -1e-9}}, 0, 1),
            std::numeric_limits<double>::infinity());
}

TEST(Contact, ProjectedBarrierIsPositiveSemidefinite) {
  const Contacts sphere = contacts_with(Collider(Sphere{1.0}, Vec3::Zero()), 1);
  BarrierTerm term(sphere);
  Vec3 g;
  Mat3 H, projected;
  const std::vector<Vec3> at = {{0.0, 0.6, 0.81}};
  term.find(at);
  term.derivatives(at, 0, 1, 1.0, &g, &H);
  term.derivatives(at, 0, 1, 0.0, &g, &projected);
  EXPECT_LT(H.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff(), -1e-3);
  EXPECT_GT(projected.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff(), -1e-12);
}

TEST(Contact, FrictionDerivatives) {
  const Contacts plane = contacts_with(Collider(Plane{Vec3::UnitZ()}, Vec3::Zero()), 4, 0.4);
  FrictionTerm term(plane);
  term.lag(
      std::vector<Vec3>{{0.0, 0.0, 0.05}, {1.0, 0.0, 0.02}, {0.0, 1.0, 0.09}, {1.0, 1.0, 0.3}});
  expect_derivatives(std::move(term),
                     {{0.01, 0.02, 0.3}, {0.2, -0.1, 0.0}, {-0.04, 0.04, -1.0}, {1.0, 0.0, 0.0}});
}

TEST(Contact, FrictionOfASlidingVertexIsCoulombs) {
  const Contacts plane = contacts_with(Collider(Plane{Vec3::UnitZ()}, Vec3::Zero()), 1, 0.4);
  const std::vector<Vec3> at = {{0.0, 0.0, 0.05}};
  FrictionTerm friction(plane);
  friction.lag(at);
  Vec3 normal, sliding;
  BarrierTerm barrier(plane);
  barrier.find(at);
  barrier.derivatives(at, 0, 1, 1.0, &normal, nullptr);
  friction.derivatives(std::vector<Vec3>{{0.3, 0.4, -0.2}}, 0, 1, 1.0, &sliding, nullptr);
  EXPECT_NEAR(sliding.norm(), 0.4 * normal.norm(), 1e-15);
  EXPECT_NEAR(sliding.dot(Vec3(0.6, 0.8, 0.0)), sliding.norm(), 1e-15);
}

// Long random steps: none goes beyond its bound into a sphere, and a plane's bound is exact.
TEST(Contact, NoStepPenetrates) {
  const Contacts sphere = contacts_with(Collider(Sphere{1.0}, Vec3(0.1, 0.2, 0.3)), 1);
  const BarrierTerm term(sphere);
  const Collider& c = sphere.colliders[0];
  int stopped = 0;
  for (int k = 0; k < 2000; ++k) {
    const double a = 0.7 * k, z = std::sin(1.3 * k);
    const Vec3 direction(std::sqrt(1 - z * z) * std::cos(a), std::sqrt(1 - z * z) * std::sin(a), z);
    const std::vector<Vec3> x = {c.position() + (1.0 + 1e-6 * (k + 1)) * direction};
    const std::vector<Vec3> dx = {4.0 * Vec3(std::sin(2.1 * k), std::cos(0.9 * k), z)};
    const double s = term.step_bound(x, dx, 0, 1);
    EXPECT_GT(s, 0.0);
    stopped += s < 1.0;
    for (int part = 1; part <= 50; ++part) {
      EXPECT_GT(c.signed_distance(x[0] + s * part / 50.0 * dx[0]).value, 0.0);
    }
  }
  EXPECT_GT(stopped, 200);
  const Contacts plane = contacts_with(Collider(Plane{Vec3::UnitZ()}, Vec3::Zero()), 1);
  const double s = BarrierTerm(plane).step_bound(std::vector<Vec3>{{0.0, 0.0, 0.01}},
                                                 std::vector<Vec3>{{5.0, 0.0, -0.1}}, 0, 1);
  EXPECT_NEAR(s, 0.09, 1e-15);
}

TEST(Contact, MovingColliderCarriesWhatItComesUpon) {
  Collider plane(Plane{Vec3::UnitZ()}, Vec3::Zero());
  plane.velocity = {0.5, 0.0, 2.0};
  const Contacts before = contacts_with(plane, 2);
  Contacts after = before;
  after.colliders[0].advance(0.1);
  std::vector<Vec3> x = {{0.0, 0.0, 0.01}, {0.0, 0.0, 1.0}};
  carry_vertices(before.colliders, after, x);
  EXPECT_NEAR((x[0] - Vec3(0.0, 0.0, 0.21)).norm(), 0.0, 1e-15);
  EXPECT_EQ(x[1], Vec3(0.0, 0.0, 1.0));
}

TEST(Contact, ProjectionIsCoulombsImpact) {
  Contacts contacts = contacts_with(Collider(Plane{Vec3::UnitZ()}, Vec3::Zero()), 2, 0.5);
  contacts.colliders[0].restitution = 0.25;
  std::vector<Vec3> x = {{1.0, 0.0, -0.01}, {0.0, 0.0, 0.5}}, v = {{3.0, 0.0, -2.0}, {0, 0, -1}};
  const std::vector<double> masses = {2.0, 1.0};
  project_contacts(contacts, masses, x, v);
  EXPECT_NEAR((x[0] - Vec3(1.0, 0.0, 0.0)).norm(), 0.0, 1e-15);
  EXPECT_NEAR((v[0] - Vec3(3.0 - 0.5 * 2.5, 0.0, 0.5)).norm(), 0.0, 1e-15);
  EXPECT_EQ(v[1], Vec3(0.0, 0.0, -1.0));
  const Vec3 given = contacts.colliders[0].exchange().impulse;
  EXPECT_NEAR((given - Vec3(2.5, 0.0, -5.0)).norm(), 0.0, 1e-14);
}

// A ball of one vertex comes to rest on a plane: the impulse it gives in a step is its weight's.
TEST(Contact, RestingVertexGivesItsWeight) {
  const double m = 0.2, h = 1.0 / 60, g = 9.81;
  Contacts contacts = contacts_with(Collider(Plane{Vec3::UnitZ()}, Vec3::Zero()), 1, 0.5);
  contacts.stiffness = {m / (h * h)};
  contacts.thickness = 1e-3;
  auto barrier = std::make_shared<BarrierTerm>(contacts);
  auto friction = std::make_shared<FrictionTerm>(contacts);
  IncrementalPotential potential(std::vector<double>{m}, std::vector<std::uint8_t>{0},
                                 {barrier, friction});
  std::vector<Vec3> x = {{0.0, 0.0, 0.05}}, v = {{0.2, 0.0, 0.0}}, gradient(1);
  std::vector<double> values(6);
  for (int step = 0; step < 240; ++step) {
    const std::vector<Vec3> x_n = x;
    const std::vector<Vec3> y = {x[0] + h * v[0] - h * h * g * Vec3::UnitZ()};
    potential.begin_step(x_n, y, h);
    for (int iteration = 0; iteration < 200; ++iteration) {
      potential.assemble(x, 0.0, gradient, values);
      if (gradient[0].norm() < 1e-9 * m * g) break;
      Mat3 H;
      H << values[0], values[1], values[2], values[1], values[3], values[4], values[2], values[4],
          values[5];
      const std::vector<Vec3> dx = {H.ldlt().solve(-gradient[0])};
      double s = potential.step_bound(x, dx);
      const double E = potential.energy(x);
      while (potential.energy(std::vector<Vec3>{x[0] + s * dx[0]}) > E && s > 1e-12) s /= 2;
      x[0] += s * dx[0];
    }
    v[0] = (x[0] - x_n[0]) / h;
    set_exchanges(contacts, *barrier, *friction, x, v, h);
    ASSERT_GT(x[0].z(), 0.0);
  }
  EXPECT_LT(v[0].norm(), 1e-6);
  const Vec3 given = contacts.colliders[0].exchange().impulse;
  EXPECT_NEAR(given.z(), -m * g * h, 1e-6 * m * g * h);
}

}  // namespace
}  // namespace substep::springs
