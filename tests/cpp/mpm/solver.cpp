// Forces on particles, for all splines and integrators.
#include "substep/mpm/solver/solver.h"

#include <gtest/gtest.h>

#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep::mpm;

// A particle alone shares its velocity with all nodes that it reaches, so that a force f changes it
// by f dt / m and turns nothing: only if f goes where the mass went.
template <int D>
void check_force_on_one(int order, Integrator integrator) {
  Options options;
  options.order = order;
  options.integrator = integrator;
  options.gravity.setZero();
  options.materials = {NeoHookean{1000, 4e3, 6e3}};
  Solver<double, D> solver(options, {});
  const Vec3 x[] = {{0.2, 0.9, D == 3 ? -0.4 : 0}}, v[] = {{1, 0, 0}};
  const std::int32_t material[] = {0};
  const double volume[] = {0.5};
  solver.add(x, v, material, volume);
  const double mass = 1000 * volume[0], dt = 1e-4;
  const Vec3 f{3e5, -1e5, D == 3 ? 2e5 : 0};
  const std::int64_t places[] = {0};
  solver.set_forces({&f, 1}, places);
  solver.step(dt);
  const Vec3 expected = v[0] + dt / mass * f;
  const std::vector<double> after = solver.velocities();
  for (int d = 0; d < D; ++d) {
    EXPECT_NEAR(after[usize(d)], expected[d], 1e-12) << "order " << order;
  }
  for (const double C : solver.affine()) EXPECT_NEAR(C, 0, 1e-11) << "order " << order;
  EXPECT_NEAR(solver.clock().supplied, mass / 2 * expected.squaredNorm(), 1e-9);
}

TEST(MpmForces, GoWhereTheMassGoes) {
  for (const int order : {1, 2, 3}) {
    for (const Integrator integrator : {Integrator::kExplicit, Integrator::kImplicit}) {
      check_force_on_one<2>(order, integrator);
      check_force_on_one<3>(order, integrator);
    }
  }
}

}  // namespace
