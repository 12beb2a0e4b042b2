// Particles of one elastic material for tests of the material point method, and the simplest update
// of a grid.
#pragma once

#include <array>
#include <random>
#include <type_traits>
#include <vector>

#include "substep/core/usize.h"
#include "substep/mpm/particles/particles.h"
#include "substep/mpm/passes/transfers.h"

namespace substep::mpm {

// One particle, in double precision: X in cells from the origin of the grid.
template <int D>
struct CloudParticle {
  std::array<double, D> X{}, v{};
  std::array<std::array<double, D>, D> C{}, F{};
  double volume = 1;
};

template <int D>
using Cloud = std::vector<CloudParticle<D>>;

inline NeoHookean soft_material() { return {.density = 1000, .mu = 400, .lambda = 600}; }

template <int D>
std::array<std::array<double, D>, D> unit_tensor() {
  std::array<std::array<double, D>, D> I{};
  for (std::size_t d = 0; d < D; ++d) I[d][d] = 1;
  return I;
}

// Particles anywhere in a box of cells around 0, in any state.
template <int D>
Cloud<D> random_cloud(int n, double cell, unsigned seed = 3) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  Cloud<D> cloud(usize(n));
  for (auto& p : cloud) {
    p.F = unit_tensor<D>();
    p.volume = std::pow(cell, D) / 4 * (1 + 0.5 * uniform(random));
    for (std::size_t i = 0; i < D; ++i) {
      p.X[i] = 5 * uniform(random), p.v[i] = uniform(random);
      for (std::size_t j = 0; j < D; ++j) {
        p.C[i][j] = uniform(random) / cell, p.F[i][j] += 0.2 * uniform(random);
      }
    }
  }
  return cloud;
}

// The entries of F in a material's fields; zz of plane strain is 1.
template <int D>
std::vector<double> tensor_fields(const std::array<std::array<double, D>, D>& F) {
  std::vector<double> fields;
  for (const auto& row : F) fields.insert(fields.end(), row.begin(), row.end());
  if (D == 2) fields.push_back(1);
  return fields;
}

template <class Real, int D>
Particles<Real, D> make_particles(const Cloud<D>& cloud, double cell,
                                  const NeoHookean& material = soft_material()) {
  Particles<Real, D> particles;
  particles.cell = cell;
  particles.materials = {material};
  ParticleRows<Real, D> rows;
  std::int32_t id = 0;
  for (const auto& p : cloud) {
    transfer::Index<D> block;
    for (std::size_t d = 0; d < D; ++d) {
      const Place at = place(p.X[d]);
      block[d] = at.block;
      rows.state.push_back(Real(at.x));
    }
    rows.blocks.push_back(block);
    for (const double f : tensor_fields<D>(p.F)) rows.state.push_back(Real(f));
    for (const double v : p.v) rows.motion.push_back(Real(v));
    for (const auto& row : p.C) {
      for (const double c : row) rows.motion.push_back(Real(c));
    }
    rows.volume.push_back(Real(p.volume));
    rows.ids.push_back(id++);
  }
  assign<Real, D>(particles, std::span<const ParticleRows<Real, D>>(&rows, 1), Order::kCells, 2);
  return particles;
}

// Back to a cloud, in the order of the ids.
template <class Real, int D>
Cloud<D> make_cloud(const Particles<Real, D>& particles) {
  const ParticleRows<Real, D> from = rows(particles, 0);
  Cloud<D> cloud(from.ids.size());
  const std::size_t stride = from.state.size() / from.ids.size();
  for (std::size_t k = 0; k < from.ids.size(); ++k) {
    auto& p = cloud[usize(from.ids[k])];
    const Real* state = from.state.data() + k * stride;
    const Real* motion = from.motion.data() + k * (D + D * D);
    p.volume = double(from.volume[k]);
    for (std::size_t i = 0; i < D; ++i) {
      p.X[i] = transfer::kBlock * double(from.blocks[k][i]) + double(state[i]);
      p.v[i] = double(motion[i]);
      for (std::size_t j = 0; j < D; ++j) {
        p.C[i][j] = double(motion[D + i * D + j]), p.F[i][j] = double(state[D + i * D + j]);
      }
    }
  }
  return cloud;
}

// Momentum becomes velocity, which grows by g dt; use(index, node) afterwards, if any.
template <class Real, int D, class Use>
void update_nodes(const Particles<Real, D>& particles, Nodes<Real, D>& nodes,
                  const std::type_identity_t<std::array<double, D>>& g_dt, Use&& use) {
  for (std::int64_t b = 0; b < particles.layout.node_blocks(); ++b) {
    const auto block = transfer::BlockKey<D>::unpack(particles.layout.node_keys[usize(b)]);
    for (int n = 0; n < nodes.kNodes; ++n) {
      Real* node = nodes.block(b) + n * transfer::kNodeReals;
      if (!(node[D] > 0)) continue;
      transfer::Index<D> index;
      for (int d = D - 1, rest = n; d >= 0; --d, rest /= transfer::kBlock) {
        index[usize(d)] = transfer::kBlock * block[usize(d)] + rest % transfer::kBlock;
      }
      for (std::size_t d = 0; d < D; ++d) node[d] = node[d] / node[D] + Real(g_dt[d]);
      use(index, node);
    }
  }
}
template <class Real, int D>
void update_nodes(const Particles<Real, D>& particles, Nodes<Real, D>& nodes,
                  const std::type_identity_t<std::array<double, D>>& g_dt = {}) {
  update_nodes(particles, nodes, g_dt, [](const auto&, Real*) {});
}

}  // namespace substep::mpm
