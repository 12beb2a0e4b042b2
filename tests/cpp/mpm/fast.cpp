// The fast path against the general one, which is tested against its formulas: each material on
// random states, over steps that flow and yield.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "cloud.h"
#include "samples.h"
#include "substep/mpm/general/general.h"

namespace substep::mpm {
namespace {

constexpr double kCellSize = 0.1;

// One of each, with the strains of the states below far beyond where those that yield do.
std::vector<AnyMaterial> soft_samples() {
  return one_of_each({.mu = 400,
                      .lambda = 600,
                      .bulk_modulus = 2000,
                      .viscosity = 2,
                      .yield_stress = 20,
                      .consistency = 5,
                      .flow_index = 1});
}

// Particles of all materials at random places of a box, in random states.
template <class Real, int D>
Particles<Real, D> random_particles(const std::vector<AnyMaterial>& materials, int of_each,
                                    double flip_rate = -1) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> uniform(-1, 1);
  Particles<Real, D> particles;
  particles.cell = kCellSize;
  particles.materials = materials;
  particles.flip_rate = flip_rate;
  std::vector<ParticleRows<Real, D>> all;
  std::int32_t id = 0;
  for (const AnyMaterial& material : materials) {
    ParticleRows<Real, D> rows;
    for (int k = 0; k < of_each; ++k) {
      transfer::Index<D> block;
      for (int& b : block) {
        const Place at = place(4 * uniform(random));
        b = at.block;
        rows.state.push_back(Real(at.x));
      }
      rows.blocks.push_back(block);
      std::visit(
          [&]<class M>(const M&) {
            const auto fields = initial_fields<M, D>();
            const std::size_t own = fields.size() - M::kState.size();
            for (std::size_t f = 0; f < fields.size(); ++f) {
              // F: any; the material's own numbers grow from where they begin.
              const double change = f < own ? 0.15 * uniform(random) : 0.05 * (1 + uniform(random));
              rows.state.push_back(Real(fields[f] + change));
            }
          },
          material);
      for (int m = 0; m < D + D * D; ++m) {
        rows.motion.push_back(Real(uniform(random) / (m < D ? 1 : kCellSize)));
      }
      rows.volume.push_back(Real(std::pow(kCellSize, D) / 8 * (1 + 0.3 * uniform(random))));
      rows.ids.push_back(id++);
    }
    all.push_back(rows);
  }
  assign<Real, D>(particles, all, Order::kCells, 2);
  return particles;
}

// The largest difference between numbers of a kind, relative to the largest number of that kind.
template <class Real>
double difference(const std::vector<Real>& a, const std::vector<Real>& b, std::size_t kinds) {
  double result = a.size() == b.size() && !a.empty() ? 0 : 1;
  for (std::size_t kind = 0; kind < kinds; ++kind) {
    double largest = 0, apart = 0;
    for (std::size_t k = kind; k < b.size(); k += kinds) {
      largest = std::max(largest, std::abs(double(b[k])));
      const double d = std::abs(double(a[k]) - double(b[k]));
      if (!(d <= apart)) apart = d;  // also where it is NaN
    }
    if (largest > 0 && !(apart / largest <= result)) result = apart / largest;
  }
  return result;
}

template <class Real, int D>
void expect_equal(const std::vector<AnyMaterial>& materials, int of_each, double flip_rate = -1) {
  const double tolerance = std::is_same_v<Real, float> ? 2e-5 : 1e-12;
  const double steps[] = {4e-3, 3e-3, 5e-3};  // c = 1 m/s or so
  std::array<double, D> g_dt{};
  g_dt[D - 1] = -0.04;
  auto fast = random_particles<Real, D>(materials, of_each, flip_rate);
  auto general = random_particles<Real, D>(materials, of_each);

  Scheme scheme;
  if (flip_rate >= 0) scheme.transfer = Transfer::kAflip, scheme.flip_rate = flip_rate;
  Nodes<Real, D> nodes, next, before;
  carry_velocities(fast, 2);
  p2g(fast, steps[0], nodes, 2);
  update_nodes(fast, nodes, g_dt);
  for (int k = 1; k < 3; ++k) {
    g2p2g(fast, steps[k - 1], steps[k], nodes, next, 2);
    update_nodes(fast, next, g_dt);
    std::swap(nodes, next);
  }
  g2p(fast, steps[2], nodes, 2);

  for (const double dt : steps) {
    p2g(scheme, general, dt, nodes, before, 2);
    update_nodes(general, nodes, g_dt);
    g2p(scheme, general, dt, nodes, before, 2);
  }
  for (std::size_t g = 0; g < materials.size(); ++g) {
    const auto a = rows(fast, g), b = rows(general, g);
    const auto n = a.ids.size();
    EXPECT_EQ(a.ids, b.ids);
    EXPECT_EQ(n, std::size_t(of_each));
    EXPECT_LT(difference(a.state, b.state, a.state.size() / n), tolerance) << g;
    EXPECT_LT(difference(a.motion, b.motion, a.motion.size() / n), tolerance) << g;
  }
}

template <class Real, int D>
void expect_equal_for_each_material() {
  for (const AnyMaterial& material : soft_samples()) {
    SCOPED_TRACE(name_of(material));
    expect_equal<Real, D>({material}, D == 3 ? 2000 : 300);
    expect_equal<Real, D>({material}, D == 3 ? 2000 : 300, 100.0);
  }
}

TEST(MpmFast, IsTheGeneralPath3dFloat) { expect_equal_for_each_material<float, 3>(); }
TEST(MpmFast, IsTheGeneralPath3dDouble) { expect_equal_for_each_material<double, 3>(); }
TEST(MpmFast, IsTheGeneralPath2dFloat) { expect_equal_for_each_material<float, 2>(); }
TEST(MpmFast, IsTheGeneralPath2dDouble) { expect_equal_for_each_material<double, 2>(); }
TEST(MpmFast, IsTheGeneralPathForAllMaterialsTogether) {
  expect_equal<double, 3>(soft_samples(), 300);
  expect_equal<double, 2>(soft_samples(), 50);
  expect_equal<double, 3>(soft_samples(), 300, 0.0);
  expect_equal<double, 2>(soft_samples(), 50, 0.0);
}

}  // namespace
}  // namespace substep::mpm
