// The implicit step against differences of its own potential, Newton's laws, and the explicit step.
#include "substep/mpm/implicit/implicit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "cloud.h"
#include "samples.h"

namespace substep::mpm {
namespace {

using geometry::Collider;
using geometry::Plane;
using geometry::Vec3;

// A block of 2^D particles per cell at rest, from cell `first` on, `cells` wide.
template <int D>
Cloud<D> block(const std::array<int, D>& cells, double cell, double first = 0) {
  Cloud<D> cloud;
  std::array<int, D> n{};
  for (;;) {
    CloudParticle<D> p;
    p.F = unit_tensor<D>();
    p.volume = std::pow(cell / 2, D);
    for (std::size_t d = 0; d < D; ++d) p.X[d] = first + 0.25 + 0.5 * n[d];
    cloud.push_back(p);
    std::size_t d = 0;
    while (d < D && ++n[d] == 2 * cells[d]) n[d++] = 0;
    if (d == D) return cloud;
  }
}

// Particles of any material with the cloud's F.
template <class Real, int D>
Particles<Real, D> particles_of(const Cloud<D>& cloud, double cell, const AnyMaterial& material) {
  Particles<Real, D> particles;
  particles.cell = cell;
  particles.materials = {material};
  ParticleRows<Real, D> rows;
  for (const auto& p : cloud) {
    transfer::Index<D> of;
    for (std::size_t d = 0; d < D; ++d) {
      const Place at = place(p.X[d]);
      of[d] = at.block;
      rows.state.push_back(static_cast<Real>(at.x));
    }
    rows.blocks.push_back(of);
    std::visit(
        [&]<class M>(const M&) {
          auto fields = initial_fields<M, D>();
          if constexpr (M::kHasF) {
            for (std::size_t k = 0; k < D * D; ++k) fields[k] = p.F[k / D][k % D];
          } else {
            fields[0] = 0.95;  // under pressure
          }
          for (const double f : fields) rows.state.push_back(static_cast<Real>(f));
        },
        material);
    for (const double v : p.v) rows.motion.push_back(static_cast<Real>(v));
    for (const auto& row : p.C) {
      for (const double c : row) rows.motion.push_back(static_cast<Real>(c));
    }
    rows.volume.push_back(static_cast<Real>(p.volume));
    rows.ids.push_back(static_cast<std::int32_t>(rows.ids.size()));
  }
  assign<Real, D>(particles, std::span<const ParticleRows<Real, D>>(&rows, 1), Order::kCells, 1);
  particles.trial = false;
  return particles;
}

template <class Real, int D>
std::span<Real> values(Nodes<Real, D>& nodes) {
  return {nodes.values.data(), nodes.values.size()};
}

// A world of one material and its implicit steps.
template <class Real, int D>
struct World {
  Particles<Real, D> particles;
  ImplicitStep<Real, D> step;
  Vec3 gravity = Vec3::Zero();
  std::vector<Collider> colliders;
  std::vector<Boundary> boundaries;
  Nodes<Real, D> nodes;
  int threads = 1;

  World(const Cloud<D>& cloud, double cell, const AnyMaterial& material,
        const ImplicitOptions& options = {.tolerance = 1e-8})
      : particles(particles_of<Real, D>(cloud, cell, material)), step(cell, options) {}

  void floor(Boundary boundary, double friction) {
    Vec3 up = Vec3::Zero();
    up[D - 1] = 1;
    colliders.emplace_back(Plane{up}, Vec3::Zero());
    colliders.back().friction = friction;
    boundaries.push_back(boundary);
  }
  const ImplicitReport& solve(double dt) {
    p2g(particles, 0.0, nodes, threads);
    return step.solve(particles, values(nodes), dt, gravity, 2, Form::kMls, colliders, boundaries,
                      threads);
  }
  void finish(double dt) {
    update_nodes<Real, D>(particles, nodes);
    g2p(particles, dt, nodes, threads);
    sort_at_rest(particles, threads);
  }
  // Sum over the nodes of mass or momentum.
  Vec3 momentum() {
    Vec3 sum = Vec3::Zero();
    for (std::size_t k = 0; k < nodes.values.size(); k += 4) {
      for (int d = 0; d < D; ++d) sum[d] += static_cast<double>(nodes.values[k + std::size_t(d)]);
    }
    return sum;
  }
  double mass() {
    double sum = 0;
    for (std::size_t k = D; k < nodes.values.size(); k += 4) sum += double(nodes.values[k]);
    return sum;
  }
};

std::vector<double> random_numbers(std::size_t n, double scale, unsigned seed, std::size_t width,
                                   std::size_t used) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-scale, scale);
  std::vector<double> x(n);
  for (std::size_t k = 0; k < n; ++k) x[k] = k % width < used ? uniform(random) : 0;
  return x;
}

double product(std::span<const double> a, std::span<const double> b) {
  double sum = 0;
  for (std::size_t k = 0; k < a.size(); ++k) sum += a[k] * b[k];
  return sum;
}

template <int D>
void check_derivatives(int order, Form form) {
  const double cell = 0.1, dt = 1e-3, h = 1e-5;
  Cloud<D> cloud = random_cloud<D>(60, cell);
  for (auto& p : cloud) {
    for (std::size_t i = 0; i < D; ++i) {
      for (std::size_t j = 0; j < D; ++j) p.F[i][j] = (i == j) + 0.05 * (p.F[i][j] - (i == j));
      p.F[i][i] -= 0.04;  // sand needs pressure
    }
  }
  for (const AnyMaterial& material : one_of_each()) {
    SCOPED_TRACE(name_of(material));
    auto particles = particles_of<double, D>(cloud, cell, material);
    Nodes<double, D> grid;
    p2g(particles, 0.0, grid, 1);
    for (std::size_t k = D; k < grid.values.size(); k += 4) grid.values[k] = 1;  // all orders reach
    ImplicitNodes<D> nodes;
    nodes.template assign<double>(particles.layout, values(grid));
    ImplicitParticles<D> forces;
    forces.template assign<double>(particles, nodes, order, form, dt, 1);
    const std::size_t n = nodes.unknowns();
    const auto v = random_numbers(n, 0.5, 1, kNodeLanes<D>, D);
    const auto x = random_numbers(n, 1, 2, kNodeLanes<D>, D);
    const auto y = random_numbers(n, 1, 3, kNodeLanes<D>, D);
    const auto shifted = [&](double by) {
      std::vector<double> w = v;
      for (std::size_t k = 0; k < n; ++k) w[k] += by * x[k];
      return w;
    };
    std::vector<double> g(n, 0.0), up(n, 0.0), down(n, 0.0), Kx(n, 0.0), Ky(n, 0.0);
    const double high = forces.evaluate(shifted(h));
    forces.add_gradient(up);
    const double low = forces.evaluate(shifted(-h));
    forces.add_gradient(down);
    forces.evaluate(v);
    forces.add_gradient(g);
    forces.linearise();
    forces.add_product(x, Kx);
    forces.add_product(y, Ky);
    // The internal forces are those of the energy, and sum to nothing.
    const double slope = product(g, x), size = std::sqrt(product(g, g) * product(x, x));
    ASSERT_GT(size, 0);
    if (forces.hyperelastic()) {
      EXPECT_NEAR((high - low) / (2 * h), slope, 1e-6 * size);
      EXPECT_NEAR(product(y, Kx), product(x, Ky), 1e-12 * std::sqrt(product(Kx, Kx) * n));
    }
    for (std::size_t d = 0; d < D; ++d) {
      double sum = 0;
      for (std::size_t k = d; k < n; k += kNodeLanes<D>) sum += g[k];
      EXPECT_NEAR(sum, 0, 1e-12 * size);
    }
    // C is kept in single precision; return maps have kinks that some particles are near to.
    double error = 0;
    for (std::size_t k = 0; k < n; ++k) {
      const double difference = (up[k] - down[k]) / (2 * h) - Kx[k];
      error += difference * difference;
    }
    EXPECT_LT(std::sqrt(error / product(Kx, Kx)), forces.hyperelastic() ? 1e-6 : 1e-3);
    // The blocks of the diagonal are those of K.
    std::vector<double> blocks(nodes.count() * D * kNodeLanes<D>, 0.0);
    forces.add_diagonal(blocks);
    for (std::size_t i = 0; i < nodes.count(); i += 7) {
      for (std::size_t l = 0; l < D; ++l) {
        std::vector<double> unit(n, 0.0), column(n, 0.0);
        unit[i * kNodeLanes<D> + l] = 1;
        forces.add_product(unit, column);
        for (std::size_t j = 0; j < D; ++j) {
          EXPECT_NEAR(blocks[(i * D + l) * kNodeLanes<D> + j], column[i * kNodeLanes<D> + j],
                      1e-10 * std::sqrt(product(Kx, Kx)));
        }
      }
    }
  }
}

TEST(MpmImplicit, ProductsAreDerivativesOfForcesAndForcesOfEnergies) {
  check_derivatives<2>(2, Form::kMls);
  check_derivatives<3>(2, Form::kMls);
  check_derivatives<2>(1, Form::kTextbook);
  check_derivatives<2>(3, Form::kTextbook);
  check_derivatives<3>(3, Form::kMls);
}

// Momentum stays, and angular momentum about the moved nodes, as the potential does not see
// rigid motions: sum (x_i + dt v_i) x m (v_i - v_i^n) = 0.
TEST(MpmImplicit, KeepsMomentumAndAngularMomentum) {
  constexpr int D = 3;
  const double cell = 0.1, dt = 0.02;
  Cloud<D> cloud = block<D>({4, 3, 3}, cell);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (auto& p : cloud) {
    for (double& v : p.v) v = uniform(random);
  }
  World<double, D> world(cloud, cell, usual<NeoHookean>(), {.tolerance = 1e-11});
  p2g(world.particles, 0.0, world.nodes, 1);
  const Nodes<double, D> before = world.nodes;
  const Vec3 momentum = world.momentum();
  const auto& report = world.solve(dt);
  ASSERT_TRUE(report.converged) << report.remedy;
  EXPECT_GT(report.newton, 1);
  EXPECT_LT((world.momentum() - momentum).norm(), 1e-10 * world.mass());
  Vec3 torque = Vec3::Zero();
  double size = 0;
  const Nodes<double, D> after = world.nodes;
  Nodes<double, D> velocities = after;
  update_nodes<double, D>(world.particles, velocities, {}, [&](const auto& index, double* node) {
    const auto k = node - velocities.values.data();
    Vec3 x, change;
    for (int d = 0; d < D; ++d) {
      x[d] = cell * index[std::size_t(d)] + dt * node[d];
      change[d] = after.values[std::size_t(k + d)] - before.values[std::size_t(k + d)];
    }
    torque += x.cross(change);
    size += x.norm() * change.norm();
  });
  EXPECT_GT(size, 0);
  EXPECT_LT(torque.norm(), 1e-9 * size);
}

// With a short step, the explicit one: they differ by O(dt^2) in the change of velocity.
TEST(MpmImplicit, ShortStepsAreThoseOfTheExplicitMethod) {
  constexpr int D = 2;
  const double cell = 0.1;
  Cloud<D> cloud = block<D>({5, 4}, cell);
  for (auto& p : cloud) p.F[0][0] = 1.05, p.F[0][1] = 0.03;
  double errors[2];
  for (int k = 0; k < 2; ++k) {
    const double dt = k == 0 ? 2e-4 : 1e-4;
    World<double, D> world(cloud, cell, usual<NeoHookean>(), {.tolerance = 1e-12});
    ASSERT_TRUE(world.solve(dt).converged);
    Nodes<double, D> explicit_nodes;
    p2g(world.particles, dt, explicit_nodes, 1);
    double error = 0, size = 0;
    for (std::size_t i = 0; i < explicit_nodes.values.size(); ++i) {
      if (i % 4 >= D) continue;
      error += std::pow(explicit_nodes.values[i] - world.nodes.values[i], 2);
      size += std::pow(explicit_nodes.values[i], 2);
    }
    errors[k] = std::sqrt(error / size);
  }
  EXPECT_LT(errors[1], 0.02);
  EXPECT_NEAR(errors[0] / errors[1], 4, 0.4);
}

// One linear system in small strains: a bar that is stretched in its lowest mode loses
// 1 / (1 + (omega dt)^2) of it per step, what backward Euler does to every oscillator.
TEST(MpmImplicit, HeavyStepsReachTheStaticStateAndDampEverythingElse) {
  constexpr int D = 2;
  const double cell = 0.1;
  World<double, D> world(block<D>({3, 6}, cell), cell,
                         NeoHookean{.density = 1000, .mu = 4e6, .lambda = 0}, {.tolerance = 1e-9});
  world.gravity = Vec3(0, -9.81, 0);
  world.floor(Boundary::kSlip, 0);
  for (int k = 0; k < 12; ++k) {
    ASSERT_TRUE(world.solve(0.05).converged) << k;
    world.finish(0.05);
  }
  // lambda = 0: no lateral stress, sigma_yy(z) = -rho g (h - z), to the order of the strain 1e-3.
  const Cloud<D> rest = make_cloud(world.particles);
  double speed = 0, error = 0;
  for (const auto& p : rest) {
    speed = std::max({speed, std::abs(p.v[0]), std::abs(p.v[1])});
    if (p.X[1] > 1.5 && p.X[1] < 4.5) {
      const double strain = -1000 * 9.81 * (0.6 - cell * p.X[1]) / 8e6;
      error = std::max(error, std::abs(p.F[1][1] - 1 - strain) / (1000 * 9.81 * 0.6 / 8e6));
    }
  }
  EXPECT_LT(speed, 1e-5);
  EXPECT_LT(error, 0.05);
}

TEST(MpmImplicit, FloorCarriesTheWeightAndLetsGo) {
  const double cell = 0.1, dt = 0.02;
  World<double, 3> world(block<3>({4, 4, 3}, cell), cell, NeoHookean{1000, 4e6, 6e6});
  world.gravity = Vec3(0, 0, -9.81);
  world.floor(Boundary::kSeparate, 0.5);
  for (int k = 0; k < 10; ++k) {
    const auto& report = world.solve(dt);
    ASSERT_TRUE(report.converged && report.settled) << k << report.remedy;
    world.finish(dt);
  }
  ASSERT_TRUE(world.solve(dt).settled);
  const double weight = world.mass() * 9.81 * dt;
  EXPECT_NEAR(world.step.exchanges()[0].impulse[2], -weight, 1e-3 * weight);
  EXPECT_LT(world.step.exchanges()[0].impulse.head<2>().norm(), 1e-3 * weight);
  // Upward gravity: no impulse, and the block leaves as one.
  world.gravity = Vec3(0, 0, 9.81);
  for (int k = 0; k < 3; ++k) {
    ASSERT_TRUE(world.solve(dt).settled);
    world.finish(dt);
  }
  ASSERT_TRUE(world.solve(dt).settled);
  EXPECT_NEAR(world.step.exchanges()[0].impulse.norm(), 0, 1e-6 * weight);
  EXPECT_NEAR(world.momentum()[2], world.mass() * 9.81 * 4 * dt, 0.15 * weight);
}

// Coulomb: a stiff block that slides loses mu g dt per step; one that is pulled by less does not
// move.
TEST(MpmImplicit, FrictionIsCoulombs) {
  constexpr int D = 2;
  const double cell = 0.1, dt = 0.01;
  for (const double pull : {0.0, 3.0}) {
    Cloud<D> cloud = block<D>({8, 2}, cell);
    for (auto& p : cloud) p.v[0] = pull > 0 ? 0 : 1;
    World<double, D> world(cloud, cell, NeoHookean{1000, 4e7, 6e7});
    world.gravity = Vec3(pull, -9.81, 0);
    world.floor(Boundary::kSeparate, 0.4);
    double speed = 0;
    for (int k = 0; k < 10; ++k) {
      const auto& report = world.solve(dt);
      ASSERT_TRUE(report.converged) << report.remedy;
      speed = world.momentum()[0] / world.mass();
      world.finish(dt);
    }
    if (pull > 0) {
      EXPECT_NEAR(speed, 0, 1e-3);
    } else {
      EXPECT_NEAR(speed, 1 - 0.4 * 9.81 * 10 * dt, 0.02);
    }
  }
}

// A column pressed to three quarters of its length: its Hessian has directions of negative
// curvature, and the energy is brought down all the same.
TEST(MpmImplicit, IndefiniteSystemsAreSolvedDownhill) {
  constexpr int D = 2;
  const double cell = 0.1;
  Cloud<D> cloud = block<D>({2, 16}, cell);
  for (auto& p : cloud) p.F[1][1] = 0.5, p.F[0][0] = 1 + 1e-3 * p.X[1];
  World<double, D> world(cloud, cell, usual<FixedCorotated>(), {.tolerance = 1e-6});
  const auto& report = world.solve(0.05);
  EXPECT_TRUE(report.converged) << report.remedy;
  EXPECT_GT(report.indefinite, 0);
}

// Every material under its own weight, after steps that an explicit method could not take.
TEST(MpmImplicit, EveryMaterialConverges) {
  constexpr int D = 2;
  const double cell = 0.05;
  for (const AnyMaterial& material : one_of_each()) {
    SCOPED_TRACE(name_of(material));
    World<float, D> world(block<D>({4, 4}, cell), cell, material, {});
    world.gravity = Vec3(0, -9.81, 0);
    world.floor(Boundary::kSeparate, 0.3);
    for (int k = 0; k < 5; ++k) {
      const auto& report = world.solve(0.01);
      ASSERT_TRUE(report.converged) << k << ": " << report.remedy << " " << report.residuals.back();
      EXPECT_LE(report.residuals.back(), 1);
      world.finish(0.01);
    }
  }
}

TEST(MpmImplicit, WhatDoesNotConvergeChangesNothing) {
  Cloud<2> cloud = block<2>({4, 4}, 0.1);
  for (auto& p : cloud) p.F[0][0] = 1.5;
  World<double, 2> world(cloud, 0.1, usual<NeoHookean>(), {.tolerance = 1e-12, .max_newton = 1});
  p2g(world.particles, 0.0, world.nodes, 1);
  const Nodes<double, 2> before = world.nodes;
  const auto& report = world.solve(0.05);
  EXPECT_FALSE(report.converged);
  EXPECT_FALSE(report.remedy.empty());
  for (std::size_t k = 0; k < before.values.size(); ++k) {
    ASSERT_EQ(before.values[k], world.nodes.values[k]);
  }
}

TEST(MpmImplicit, SameBitsForAnyNumberOfThreads) {
  Nodes<float, 3> first;
  for (const int threads : {1, 2, 3}) {
    World<float, 3> world(block<3>({6, 5, 4}, 0.1), 0.1, usual<NeoHookean>(), {});
    world.threads = threads;
    world.gravity = Vec3(0, 0, -9.81);
    world.floor(Boundary::kSeparate, 0.3);
    for (int k = 0; k < 2; ++k) {
      const auto& report = world.solve(0.02);
      ASSERT_TRUE(report.converged) << report.remedy;
      if (k == 0) world.finish(0.02);
    }
    if (threads == 1) first = world.nodes;
    ASSERT_EQ(first.values.size(), world.nodes.values.size());
    EXPECT_EQ(std::memcmp(first.values.data(), world.nodes.values.data(),
                          first.values.size() * sizeof(float)),
              0)
        << threads;
  }
}

TEST(MpmImplicit, NothingAndOneParticle) {
  World<float, 2> empty(Cloud<2>{}, 0.1, usual<NeoHookean>(), {});
  EXPECT_TRUE(empty.solve(0.01).converged);
  Cloud<2> one(1);
  one[0].F = unit_tensor<2>();
  World<double, 2> world(one, 0.1, usual<Sand>());
  world.gravity = Vec3(0, -9.81, 0);
  ASSERT_TRUE(world.solve(0.01).converged);
  EXPECT_NEAR(world.momentum()[1], -0.0981 * world.mass(), 1e-9 * world.mass());
}

}  // namespace
}  // namespace substep::mpm
