// Particles in blocks, and the passes of the fast path over all materials at once: order, bits,
// sums.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <random>
#include <set>

#include "cloud.h"
#include "samples.h"
#include "substep/core/usize.h"
#include "substep/mpm/particles/cells.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::mpm;
using transfer::BlockKey;
using transfer::Index;

constexpr double kSpacing = 0.1, kStep = 1e-3;

template <int D>
std::vector<double> at_rest(const AnyMaterial& any) {
  return std::visit(
      [](const auto& material) {
        const auto fields = initial_fields<std::remove_cvref_t<decltype(material)>, D>();
        return std::vector<double>(fields.begin(), fields.end());
      },
      any);
}

// Particles of all materials, mixed in a box around 0; a few far away.
template <class Real, int D>
Particles<Real, D> mixture(int of_each, double speed = 3, unsigned seed = 5) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  Particles<Real, D> particles;
  particles.cell = kSpacing;
  particles.materials = one_of_each();
  std::vector<ParticleRows<Real, D>> groups(particles.materials.size());
  std::int32_t id = 0;
  for (std::size_t g = 0; g < groups.size(); ++g) {
    auto& rows = groups[g];
    for (int i = 0; i < of_each; ++i) {
      Index<D> block;
      for (std::size_t d = 0; d < D; ++d) {
        const Place at = place((i % 50 == 7 ? 3000 : 6) * uniform(random));
        block[d] = at.block;
        rows.state.push_back(static_cast<Real>(at.x));
      }
      rows.blocks.push_back(block);
      for (const double f : at_rest<D>(particles.materials[g])) {
        rows.state.push_back(static_cast<Real>(f * (1 + 1e-3 * uniform(random))));
      }
      for (int d = 0; d < D; ++d) rows.motion.push_back(static_cast<Real>(speed * uniform(random)));
      for (int k = 0; k < D * D; ++k) rows.motion.push_back(static_cast<Real>(uniform(random)));
      rows.volume.push_back(
          static_cast<Real>(std::pow(kSpacing, D) / 4 * (1 + 0.5 * uniform(random))));
      rows.ids.push_back(id++);
    }
  }
  assign<Real, D>(particles, groups, Order::kCells, 2);
  return particles;
}

// Everything of every particle, by id: X [cells], fields, v, C, V_0.
template <class Real, int D>
std::map<std::int32_t, std::vector<double>> everything(const Particles<Real, D>& particles) {
  std::map<std::int32_t, std::vector<double>> all;
  for (std::size_t g = 0; g < particles.groups.size(); ++g) {
    const auto from = rows(particles, g);
    const auto state = usize(D + particles.groups[g].fields);
    constexpr std::size_t kMotion = D + D * D;
    for (std::size_t i = 0; i < from.ids.size(); ++i) {
      std::vector<double> one;
      for (std::size_t k = 0; k < state; ++k) {
        const double value = from.state[i * state + k];
        one.push_back(k < D ? value + transfer::kBlock * static_cast<double>(from.blocks[i][k])
                            : value);
      }
      for (std::size_t k = 0; k < kMotion; ++k) one.push_back(from.motion[i * kMotion + k]);
      one.push_back(from.volume[i]);
      EXPECT_TRUE(all.emplace(from.ids[i], one).second) << "id " << from.ids[i] << " twice";
    }
  }
  return all;
}

template <class Real, int D>
double fastest(const Nodes<Real, D>& nodes) {
  Real most = 0;
  for (std::int64_t b = 0; b < nodes.blocks(); ++b) {
    for (int n = 0; n < nodes.kReals; n += transfer::kNodeReals) {
      for (int d = 0; d < D; ++d) most = std::max(most, std::abs(nodes.block(b)[n + d]));
    }
  }
  return static_cast<double>(most);
}

// A run of steps as the solver does it; counts sorts.
template <class Real, int D>
int run(Particles<Real, D>& particles, int steps, int threads, bool fused, double& drift) {
  Nodes<Real, D> nodes, next;
  int sorts = 0;
  p2g(particles, kStep, nodes, threads);
  for (int step = 0; step < steps; ++step) {
    update_nodes(particles, nodes);
    const double moves = fastest(nodes) * kStep / kSpacing;
    if (fused && drift + moves > drift_limit(2)) {
      sort(particles, nodes, threads);
      ++sorts;
      drift = 0;
    }
    drift += moves;
    if (fused && step + 1 < steps) {
      g2p2g(particles, kStep, kStep, nodes, next, threads);
      std::swap(nodes, next);
    } else {
      g2p(particles, kStep, nodes, threads);
      if (step + 1 < steps) p2g(particles, kStep, nodes, threads);
    }
  }
  return sorts;
}

template <class Types>
class MpmTransfers : public testing::Test {};

template <class Real_, int D_>
struct Variant {
  using Real = Real_;
  static constexpr int D = D_;
};
using Cases =
    testing::Types<Variant<float, 2>, Variant<float, 3>, Variant<double, 2>, Variant<double, 3>>;
TYPED_TEST_SUITE(MpmTransfers, Cases);

TYPED_TEST(MpmTransfers, KeysAscendAsBlocksDo) {
  constexpr int D = TypeParam::D;
  std::mt19937 random(1);
  std::uniform_int_distribution<std::int32_t> anywhere(-(1 << 20), (1 << 20) - 1);
  for (int i = 0; i < 1000; ++i) {
    Index<D> a, b;
    for (std::size_t d = 0; d < D; ++d) a[d] = anywhere(random), b[d] = anywhere(random);
    if (i % 3 == 0) b[0] = a[0];
    EXPECT_EQ(BlockKey<D>::unpack(BlockKey<D>::pack(a)), a);
    EXPECT_EQ(BlockKey<D>::pack(a) < BlockKey<D>::pack(b), a < b);
  }
}

TYPED_TEST(MpmTransfers, LayoutHasAllArenasAndColoursKeepThemApart) {
  constexpr int D = TypeParam::D;
  const auto particles = mixture<typename TypeParam::Real, D>(300);
  const auto& layout = particles.layout;
  ASSERT_TRUE(std::is_sorted(layout.particle_keys.begin(), layout.particle_keys.end()));
  std::set<std::uint64_t> needed;
  for (std::size_t b = 0; b < layout.particle_keys.size(); ++b) {
    const Index<D> block = BlockKey<D>::unpack(layout.particle_keys[b]);
    for (int corner = 0; corner < layout.kCorners; ++corner) {
      Index<D> node_block = block;
      for (int d = 0; d < D; ++d) node_block[usize(d)] += corner >> (D - 1 - d) & 1;
      const auto at = usize(layout.arenas[b][usize(corner)]);
      EXPECT_EQ(layout.node_keys[at], BlockKey<D>::pack(node_block));
      needed.insert(layout.node_keys[at]);
    }
  }
  EXPECT_EQ(std::vector<std::uint64_t>(needed.begin(), needed.end()), layout.node_keys);
  std::size_t coloured = 0;
  for (const auto& colour : layout.colours) {
    std::set<std::int32_t> written;
    for (const std::int32_t b : colour) {
      for (const std::int32_t n : layout.arenas[usize(b)]) {
        EXPECT_TRUE(written.insert(n).second);
      }
    }
    coloured += colour.size();
  }
  EXPECT_EQ(coloured, layout.particle_keys.size());
}

TYPED_TEST(MpmTransfers, SortedByBlockAndCellAndNothingIsLost) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D, kWidth = kLanes<Real>;
  auto particles = mixture<Real, D>(400);
  auto before = everything(particles);
  // All over the place, as far as particles may go between two sorts.
  std::mt19937 random(9);
  std::uniform_real_distribution<double> uniform(-drift_limit(2), drift_limit(2));
  for (auto& group : particles.groups) {
    for (const Run& run : group.runs) {
      for (std::int32_t i = 0; i < run.packets * kWidth; ++i) {
        Real* x = group.packet(run.first + i / kWidth) + i % kWidth;
        const auto id = group.ids[usize(run.first * kWidth + i)];
        for (std::size_t d = 0; d < D; ++d) {
          const Real moved = x[d * kWidth] + static_cast<Real>(uniform(random));
          if (id >= 0)
            before[id][d] += static_cast<double>(moved) - static_cast<double>(x[d * kWidth]);
          x[d * kWidth] = moved;
        }
      }
    }
  }
  sort_at_rest(particles, 2);
  const auto after = everything(particles);
  ASSERT_EQ(after.size(), before.size());
  for (const auto& [id, numbers] : after) {
    for (std::size_t k = 0; k < numbers.size(); ++k) {
      const double tolerance = k < D ? 8 * std::numeric_limits<Real>::epsilon() : 0;
      EXPECT_NEAR(numbers[k], before[id][k], tolerance) << "id " << id << ", number " << k;
    }
  }
  for (const auto& group : particles.groups) {
    for (const Run& run : group.runs) {
      int last = 0;
      for (std::int32_t i = 0; i < run.packets * kWidth; ++i) {
        const Real* x = group.packet(run.first + i / kWidth) + i % kWidth;
        const auto slot = usize(run.first * kWidth + i);
        EXPECT_EQ(group.ids[slot] < 0, i >= run.count);
        const auto where = Cells<D>::where(x, kWidth);
        bool rounded_up = false;  // to the next block's first position
        for (int d = 0; d < D; ++d) {
          EXPECT_GE(x[d * kWidth], 1.5) << i;
          EXPECT_LE(x[d * kWidth], 5.5) << i;
          rounded_up |= x[d * kWidth] == static_cast<Real>(5.5);
        }
        if (rounded_up) continue;
        EXPECT_EQ(where.neighbour, Cells<D>::kNeighbours / 2);
        EXPECT_GE(where.cell, last);
        last = where.cell;
      }
    }
  }
}

TYPED_TEST(MpmTransfers, RowsGiveTheSameStateAgain) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto particles = mixture<Real, D>(200);
  double drift = 0;
  run(particles, 4, 1, true, drift);
  Particles<Real, D> again;
  again.cell = particles.cell;
  again.materials = particles.materials;
  again.before = particles.before;
  std::vector<ParticleRows<Real, D>> groups;
  for (std::size_t g = 0; g < particles.groups.size(); ++g) groups.push_back(rows(particles, g));
  assign<Real, D>(again, groups, Order::kAsGiven, 1);
  EXPECT_EQ(everything(particles), everything(again));
  double same_drift = drift;
  run(particles, 60, 1, true, drift);
  run(again, 60, 1, true, same_drift);
  EXPECT_EQ(everything(particles), everything(again));
}

TYPED_TEST(MpmTransfers, NodesHaveTheMassAndMomentaOfTheParticles) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto particles = mixture<Real, D>(300);
  // Angular momentum about the origin, entry (i, j): sum m (X_i v_j - X_j v_i) dx, and of the
  // affine motion dx^2 / 4 m (C_ji - C_ij) (Jiang et al., "The affine particle-in-cell method",
  // 2015, section 5.3.1). Kirchhoff stresses are symmetric: they add nothing.
  double mass = 0, p[D] = {}, L = 0, size = 0;
  for (std::size_t g = 0; g < particles.groups.size(); ++g) {
    const double density =
        std::visit([](const auto& m) { return m.density; }, particles.materials[g]);
    const auto from = rows(particles, g);
    const auto state = usize(D + particles.groups[g].fields);
    for (std::size_t i = 0; i < from.ids.size(); ++i) {
      const Real* motion = &from.motion[i * (D + D * D)];
      const double m = density * from.volume[i];
      double X[D];
      for (std::size_t d = 0; d < D; ++d) {
        X[d] =
            from.state[i * state + d] + transfer::kBlock * static_cast<double>(from.blocks[i][d]);
        p[d] += m * motion[d];
      }
      mass += m;
      const double one = m * kSpacing * (X[0] * motion[1] - X[1] * motion[0]);
      L += one + kSpacing * kSpacing / 4 * m * (motion[D + D] - motion[D + 1]);
      size += std::abs(one);
    }
  }
  Nodes<Real, D> nodes;
  p2g(particles, kStep, nodes, 2);
  double node_mass = 0, node_p[D] = {}, node_L = 0;
  for (std::int64_t b = 0; b < nodes.blocks(); ++b) {
    const auto block = BlockKey<D>::unpack(particles.layout.node_keys[usize(b)]);
    for (int n = 0; n < nodes.kNodes; ++n) {
      const Real* node = nodes.block(b) + n * transfer::kNodeReals;
      const int i = D == 3 ? n / 16 : n / 4, j = D == 3 ? n / 4 % 4 : n % 4;
      const double x = transfer::kBlock * static_cast<double>(block[0]) + i,
                   y = transfer::kBlock * static_cast<double>(block[1]) + j;
      node_mass += node[D];
      for (int d = 0; d < D; ++d) node_p[d] += node[d];
      node_L += kSpacing * (x * node[1] - y * node[0]);
    }
  }
  const double epsilon = std::numeric_limits<Real>::epsilon();
  EXPECT_NEAR(node_mass, mass, 8 * epsilon * mass);
  // Forces within a stencil cancel: what is left is the rounding of terms of their size.
  const double force =
      kStep * 4 / (kSpacing * kSpacing) * 1e5 * std::pow(kSpacing, D) * 3 * kSpacing;
  for (int d = 0; d < D; ++d) {
    EXPECT_NEAR(node_p[d], p[d], 100 * epsilon * (3 * mass + 50 * force)) << d;
  }
  EXPECT_NEAR(node_L, L, 100 * epsilon * (size + 6 * kSpacing * 50 * force));
}

TYPED_TEST(MpmTransfers, AffineVelocitiesArriveExactly) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto particles = mixture<Real, D>(100);
  Nodes<Real, D> nodes;
  p2g(particles, kStep, nodes, 1);
  // v = A i, with i within a few cells of the origin, else 0.
  double A[D][D];
  for (int c = 0; c < D; ++c) {
    for (int d = 0; d < D; ++d) A[c][d] = 0.3 * c - 0.2 * d + 0.1;
  }
  update_nodes(particles, nodes, {}, [&](const Index<D>& index, Real* node) {
    for (int c = 0; c < D; ++c) {
      double v = 0;
      for (int d = 0; d < D; ++d) v += A[c][d] * index[usize(d)];
      node[c] = static_cast<Real>(v);
    }
  });
  const auto before = everything(particles);
  g2p(particles, kStep, nodes, 1);
  int near = 0;
  for (const auto& [id, numbers] : everything(particles)) {
    const double* X = before.at(id).data();
    if (std::abs(X[0]) > 6 || std::abs(X[1]) > 6 || std::abs(X[D - 1]) > 6) continue;
    ++near;
    const double* motion = &numbers[numbers.size() - 1 - (D + D * D)];
    const double tolerance = 100 * std::numeric_limits<Real>::epsilon();
    for (int c = 0; c < D; ++c) {
      double v = 0;
      for (int d = 0; d < D; ++d) {
        v += A[c][d] * X[d];
        EXPECT_NEAR(motion[D + c * D + d], A[c][d] / kSpacing, tolerance / kSpacing);
      }
      EXPECT_NEAR(motion[c], v, tolerance);
      EXPECT_NEAR(numbers[usize(c)], X[c] + kStep / kSpacing * v, tolerance);
    }
  }
  EXPECT_GT(near, 400);
}

TYPED_TEST(MpmTransfers, FusedStepsGiveTheBitsOfSplitOnes) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto fused = mixture<Real, D>(150, 0.5), split = mixture<Real, D>(150, 0.5);
  double drift = 0;
  EXPECT_EQ(run(fused, 10, 2, true, drift), 0);
  run(split, 10, 2, false, drift);
  EXPECT_EQ(everything(fused), everything(split));
}

TYPED_TEST(MpmTransfers, SameBitsForAnyNumberOfThreads) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  auto one = mixture<Real, D>(150);
  double drift = 0;
  EXPECT_GT(run(one, 100, 1, true, drift), 2);
  for (const int threads : {2, 3, 4}) {
    auto many = mixture<Real, D>(150);
    double same_drift = 0;
    run(many, 100, threads, true, same_drift);
    EXPECT_EQ(everything(one), everything(many)) << threads;
    EXPECT_EQ(drift, same_drift);
  }
}

// Steps from a snapshot are the steps from before it.
TYPED_TEST(MpmTransfers, RewindRepeatsSteps) {
  using Real = typename TypeParam::Real;
  constexpr int D = TypeParam::D;
  for (const bool sorted : {false, true}) {
    auto particles = mixture<Real, D>(150, 0.5);
    Nodes<Real, D> nodes, next;
    p2g(particles, kStep, nodes, 2);
    update_nodes(particles, nodes);
    if (sorted) {
      g2p2g(particles, kStep, kStep, nodes, next, 2);
      std::swap(nodes, next);
      update_nodes(particles, nodes);
      sort(particles, nodes, 2);
    }
    const Nodes<Real, D> kept = nodes;
    const auto steps = [&](int count) {
      for (int step = 0; step < count; ++step) {
        g2p2g(particles, kStep, kStep, nodes, next, 2);
        std::swap(nodes, next);
        update_nodes(particles, nodes);
      }
    };
    steps(3);
    auto three = particles;
    g2p(three, kStep, nodes, 2);
    steps(5);
    rewind(particles, 2);
    nodes = kept;
    steps(3);
    g2p(particles, kStep, nodes, 2);
    EXPECT_EQ(everything(particles), everything(three)) << sorted;
  }
}

}  // namespace
