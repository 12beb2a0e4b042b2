// The passes of a step of the material point method, one by one: the split of its time.
//
// A cube of particles at random, 8 a cell (in 2D a square, 4), float32. "per_item" is the time per
// particle; the last number of a name is that of the threads. SUBSTEP_BENCH builds it.
//
// Bytes and flops of a particle, elastic and in 3D. It has x and F (48 bytes) and, between runs of
// steps, v and C (48); its volume and its number (4 each). A node is 16 bytes; there are 8
// particles to a node. P2G reads x, F, v, C, V and adds to nodes (2 * 2); the fused pass reads and
// writes x and F, reads V and nodes and adds to others; G2P reads x and F, writes all, and reads
// nodes; the sort reads and writes x, F, V and the number. Flops: the stress is 14 of det F, 30 of
// F F^T and 16; B and Q of scatter (packet_passes.h) 55; weights 24; a row of 12 numbers in scatter
// 36 + 24, its additions for 9 pairs of nodes 9 * 24 + 72 + 24: 511 in all. Gather is 252 + 180
// (stencil.h), C 27, F <- (I + dt C) F 54, x 6 and weights 24: 543. A node's update is 8.
#include <benchmark/benchmark.h>

#include <cmath>
#include <vector>

#include "substep/mpm/passes/grid_update.h"
#include "substep/mpm/passes/transfers.h"
#include "work.h"

namespace {

using namespace substep;
using namespace substep::mpm;

constexpr double kCell = 1.0 / 128, kStep = 1e-5;
constexpr double kMu = 4.2e4, kLambda = 2.8e4;

template <class M>
M material() {
  M m;
  m.density = 1000, m.mu = kMu, m.lambda = kLambda;
  return m;
}

template <int D, class M>
Particles<float, D> cube(int n) {
  Particles<float, D> particles;
  particles.cell = kCell;
  particles.materials = {material<M>()};
  const int per_cell = D == 3 ? 8 : 4;
  const double side = std::pow(static_cast<double>(n) / per_cell, 1.0 / D);
  const auto fields = initial_fields<M, D>();
  std::vector<ParticleRows<float, D>> rows(1);
  std::uint64_t bits = 1;
  const auto uniform = [&] {
    bits = bits * 6364136223846793005u + 1442695040888963407u;
    return static_cast<double>(bits >> 11) * 0x1p-53;
  };
  for (int i = 0; i < n; ++i) {
    transfer::Index<D> block;
    for (std::size_t d = 0; d < D; ++d) {
      const Place at = place(side * uniform());
      block[d] = at.block;
      rows[0].state.push_back(static_cast<float>(at.x));
    }
    rows[0].blocks.push_back(block);
    for (const double f : fields) rows[0].state.push_back(static_cast<float>(f));
    for (int k = 0; k < D + D * D; ++k) {
      rows[0].motion.push_back(static_cast<float>(0.1 * uniform()));
    }
    rows[0].volume.push_back(static_cast<float>(std::pow(kCell, D) / per_cell));
    rows[0].ids.push_back(i);
  }
  assign<float, D>(particles, rows, Order::kCells, 0);
  return particles;
}

enum Pass { kP2g, kGrid, kG2p2g, kG2p, kSort };

// Arguments: particles, threads.
template <Pass kPass, int D, class M>
void pass(benchmark::State& state) {
  const auto n = static_cast<int>(state.range(0)), threads = static_cast<int>(state.range(1));
  auto particles = cube<D, M>(n);
  GridUpdate<float, D> grid(kCell, {}, {});
  Nodes<float, D> nodes, next;
  const auto update = [&](Nodes<float, D>& of) {
    grid.update({of.values.data(), of.values.size()}, {0, 0, -9.81}, kStep, 1e30, threads);
  };
  grid.set_layout(particles.layout, threads);
  p2g(particles, kStep, nodes, threads);
  update(nodes);
  if (kPass == kG2p2g || kPass == kSort) {
    g2p2g(particles, kStep, kStep, nodes, next, threads);
    std::swap(nodes, next);
    update(nodes);
  }
  for (auto _ : state) {
    if constexpr (kPass == kP2g) p2g(particles, kStep, nodes, threads);
    if constexpr (kPass == kGrid) update(nodes);
    if constexpr (kPass == kG2p2g) g2p2g(particles, kStep, kStep, nodes, next, threads);
    if constexpr (kPass == kG2p) g2p(particles, kStep, nodes, threads);
    if constexpr (kPass == kSort) sort(particles, nodes, threads);
  }
  constexpr double kBytes[] = {104, 4, 104 + 2, 48 + 100 + 2, 2 * 56};
  constexpr double kSet[] = {104, 2, 56, 102, 112};  // what is read and written in its place, once
  constexpr double kFlops[] = {511, 1, 543 + 511, 543, 0};
  if (D == 3 && std::is_same_v<M, NeoHookean> && threads == 1) {
    bench::report(state, {.items = static_cast<double>(n),
                          .bytes = kBytes[kPass],
                          .flops = kFlops[kPass],
                          .set = kSet[kPass] * n});
  }
  state.counters["per_item"] = benchmark::Counter(
      n, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void sizes(benchmark::internal::Benchmark* of) {
  of->Unit(benchmark::kMillisecond)->UseRealTime()->ArgsProduct({{1'000'000}, {1, 2}});
}
void small(benchmark::internal::Benchmark* of) {
  of->Unit(benchmark::kMillisecond)->UseRealTime()->ArgsProduct({{100'000}, {1, 2}});
}

BENCHMARK(pass<kP2g, 3, NeoHookean>)->Apply(sizes)->Name("mpm/p2g/3D/elastic");
BENCHMARK(pass<kGrid, 3, NeoHookean>)->Apply(sizes)->Name("mpm/grid/3D/elastic");
BENCHMARK(pass<kG2p2g, 3, NeoHookean>)->Apply(sizes)->Name("mpm/g2p2g/3D/elastic");
BENCHMARK(pass<kG2p2g, 3, Snow>)->Apply(sizes)->Name("mpm/g2p2g/3D/snow");
BENCHMARK(pass<kG2p2g, 3, Sand>)->Apply(sizes)->Name("mpm/g2p2g/3D/sand");
BENCHMARK(pass<kG2p, 3, NeoHookean>)->Apply(sizes)->Name("mpm/g2p/3D/elastic");
BENCHMARK(pass<kSort, 3, NeoHookean>)->Apply(sizes)->Name("mpm/sort/3D/elastic");
BENCHMARK(pass<kGrid, 2, NeoHookean>)->Apply(small)->Name("mpm/grid/2D/elastic");
BENCHMARK(pass<kG2p2g, 2, NeoHookean>)->Apply(small)->Name("mpm/g2p2g/2D/elastic");

}  // namespace
