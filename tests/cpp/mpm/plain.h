// The plainest material point method, for tests of what acts on its grid: APIC with quadratic
// splines, stress by moving least squares, particle by particle on a box of blocks.
// Hu et al., "A moving least squares material point method", 2018, eqs. 14 to 19.
#pragma once

#include <array>
#include <cmath>
#include <functional>
#include <vector>

#include "substep/core/usize.h"
#include "substep/mpm/passes/grid_update.h"

namespace plain {

using substep::usize;

using substep::geometry::Exchange;
using substep::geometry::Mat3;
using substep::geometry::Vec3;
namespace mpm = substep::mpm;
namespace transfer = substep::transfer;

struct Particle {
  Vec3 x = Vec3::Zero(), v = Vec3::Zero();
  Mat3 C = Mat3::Zero(), F = Mat3::Identity();
};

// All blocks with coordinates in [-half, half).
template <int D>
transfer::BlockLayout<D> box_of_blocks(int half) {
  transfer::BlockLayout<D> layout;
  transfer::Index<D> at;
  const auto walk = [&](auto&& self, int d) -> void {
    if (d == D) {
      layout.node_keys.push_back(transfer::BlockKey<D>::pack(at));
      return;
    }
    for (int i = -half; i < half; ++i) {
      at[usize(d)] = i;
      self(self, d + 1);
    }
  };
  walk(walk, 0);
  layout.particle_keys = layout.node_keys;
  return layout;
}

template <class Real, int D>
class Simulation {
 public:
  Simulation(double cell, int half, std::vector<substep::geometry::Collider> colliders,
             std::vector<mpm::Boundary> boundaries, double reach = 0)
      : grid(cell, std::move(colliders), std::move(boundaries), reach),
        cell_(cell),
        half_(half),
        layout_(box_of_blocks<D>(half)),
        nodes_(layout_.node_keys.size() * transfer::NodeBlocks<Real, D>::kReals) {
    grid.set_layout(layout_, 1);
  }

  mpm::GridUpdate<Real, D> grid;
  std::vector<Particle> particles;
  Vec3 gravity = Vec3::Zero();
  double density = 1000, volume = 1, mu = 0, lambda = 0;
  int threads = 1;

  double mass() const { return density * volume; }
  // visit(x, v) for the nodes that have mass.
  template <class Visit>
  void for_nodes(Visit&& visit) const {
    for (std::size_t i = 0; i < nodes_.size(); i += 4) {
      if (nodes_[i + D] == 0) continue;
      const std::size_t nodes = transfer::NodeBlocks<Real, D>::kNodes;
      const auto block = transfer::BlockKey<D>::unpack(layout_.node_keys[i / 4 / nodes]);
      Vec3 x = Vec3::Zero(), v = Vec3::Zero();
      for (int d = D - 1, rest = static_cast<int>(i / 4 % nodes); d >= 0; --d, rest /= 4) {
        x[d] = cell_ * (4 * block[usize(d)] + rest % 4);
        v[d] = static_cast<double>(nodes_[i + usize(d)]);
      }
      visit(x, v);
    }
  }

  mpm::NodeCheck step(double dt, double bound = 1e30) {
    p2g(dt);
    const mpm::NodeCheck check = grid.update(nodes_, gravity, dt, bound, threads);
    if (!check.good()) return check;
    for (Particle& p : particles) g2p(p, dt);
    excess = grid.finish();
    return check;
  }
  double excess = 0;

 private:
  // function(node, weight, node - particle [m]).
  template <class Function>
  void stencil(const Vec3& x, Function&& function) {
    std::array<std::array<double, 3>, 3> w{};
    std::array<int, 3> base{};
    Vec3 off = Vec3::Zero();
    for (int d = 0; d < D; ++d) {
      const auto u = usize(d);
      const double X = x[d] / cell_;
      base[u] = static_cast<int>(std::floor(X - 0.5));
      off[d] = X - base[u];
      const double t = off[d];
      w[u] = {0.5 * (1.5 - t) * (1.5 - t), 0.75 - (t - 1) * (t - 1), 0.5 * (t - 0.5) * (t - 0.5)};
    }
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        for (int k = 0; k < (D == 3 ? 3 : 1); ++k) {
          const std::array<int, 3> step{i, j, k};
          double weight = 1;
          Vec3 arm = Vec3::Zero();
          std::size_t block = 0, node = 0;
          for (int d = 0; d < D; ++d) {
            const auto u = usize(d);
            const int index = base[u] + step[u] + 4 * half_;
            weight *= w[u][usize(step[u])];
            arm[d] = cell_ * (step[u] - off[d]);
            block = block * usize(2 * half_) + usize(index / 4);
            node = node * 4 + usize(index % 4);
          }
          function(&nodes_.at(block * transfer::NodeBlocks<Real, D>::kReals + node * 4), weight,
                   arm);
        }
      }
    }
  }

  void p2g(double dt) {
    std::fill(nodes_.begin(), nodes_.end(), Real{0});
    for (const Particle& p : particles) {
      const double J = p.F.determinant();
      const Mat3 tau = mu * (p.F * p.F.transpose() - Mat3::Identity()) +
                       0.5 * lambda * (J * J - 1) * Mat3::Identity();
      const Mat3 Q = mass() * p.C - dt * volume * 4 / (cell_ * cell_) * tau;
      stencil(p.x, [&](Real* node, double w, const Vec3& arm) {
        const Vec3 momentum = w * (mass() * p.v + Q * arm);
        for (int d = 0; d < D; ++d) node[d] += static_cast<Real>(momentum[d]);
        node[D] += static_cast<Real>(w * mass());
      });
    }
  }

  void g2p(Particle& p, double dt) {
    Vec3 v = Vec3::Zero();
    Mat3 C = Mat3::Zero();
    stencil(p.x, [&](const Real* node, double w, const Vec3& arm) {
      Vec3 at = Vec3::Zero();
      for (int d = 0; d < D; ++d) at[d] = static_cast<double>(node[d]);
      v += w * at;
      C += w * 4 / (cell_ * cell_) * at * arm.transpose();
    });
    p.C = C;
    p.F = (Mat3::Identity() + dt * C) * p.F;
    constexpr int kWidth = mpm::kLanes<Real>;
    alignas(64) Real before[D * kWidth] = {}, x[D * kWidth] = {}, u[D * kWidth] = {};
    alignas(64) Real volumes[kWidth] = {static_cast<Real>(volume)};
    std::size_t block = 0;
    Vec3 first = Vec3::Zero();
    for (int d = 0; d < D; ++d) {
      const mpm::Place at = mpm::place(p.x[d] / cell_);
      block = block * usize(2 * half_) + usize(at.block + half_);
      first[d] = cell_ * 4 * at.block;
      before[d * kWidth] = static_cast<Real>(at.x);
      x[d * kWidth] = before[d * kWidth] + static_cast<Real>(v[d] * dt / cell_);
      u[d * kWidth] = static_cast<Real>(v[d]);
    }
    const auto b = static_cast<std::int32_t>(block);
    if (grid.particles().near(b)) {
      grid.particles().settle(b, before, x, u, volumes, density, 1);
    }
    for (int d = 0; d < D; ++d) {
      p.x[d] = first[d] + cell_ * static_cast<double>(x[d * kWidth]);
      p.v[d] = static_cast<double>(u[d * kWidth]);
    }
  }

  double cell_;
  int half_;
  transfer::BlockLayout<D> layout_;
  std::vector<Real> nodes_;
};

}  // namespace plain
