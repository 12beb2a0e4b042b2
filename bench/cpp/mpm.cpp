// The passes of a step of the material point method, one by one: the split of its time.
//
// A cube of particles at random, 8 a cell (in 2D a square, 4), float32. "per_item" is the time per
// particle; the last number of a name is that of the threads. SUBSTEP_BENCH builds it.
#include <benchmark/benchmark.h>

#include <cmath>
#include <vector>

#include "substep/mpm/passes/grid_update.h"
#include "substep/mpm/passes/transfers.h"

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
  state.counters["per_item"] = benchmark::Counter(
      n, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void sizes(benchmark::internal::Benchmark* of) {
  of->Unit(benchmark::kMillisecond)->UseRealTime()->ArgsProduct({{1'000'000}, {1, 2}});
}
void small(benchmark::internal::Benchmark* of) {
  of->Unit(benchmark::kMillisecond)->UseRealTime()->ArgsProduct({{100'000}, {1, 2}});
}

BENCHMARK(pass<kP2g, 3, NeoHookean>)->Apply(sizes)->Name("p2g/3D/elastic");
BENCHMARK(pass<kGrid, 3, NeoHookean>)->Apply(sizes)->Name("grid/3D/elastic");
BENCHMARK(pass<kG2p2g, 3, NeoHookean>)->Apply(sizes)->Name("g2p2g/3D/elastic");
BENCHMARK(pass<kG2p2g, 3, Snow>)->Apply(sizes)->Name("g2p2g/3D/snow");
BENCHMARK(pass<kG2p2g, 3, Sand>)->Apply(sizes)->Name("g2p2g/3D/sand");
BENCHMARK(pass<kG2p, 3, NeoHookean>)->Apply(sizes)->Name("g2p/3D/elastic");
BENCHMARK(pass<kSort, 3, NeoHookean>)->Apply(sizes)->Name("sort/3D/elastic");
BENCHMARK(pass<kGrid, 2, NeoHookean>)->Apply(small)->Name("grid/2D/elastic");
BENCHMARK(pass<kG2p2g, 2, NeoHookean>)->Apply(small)->Name("g2p2g/2D/elastic");

}  // namespace
