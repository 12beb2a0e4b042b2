// Advection of particles by RK4: in a flow in closed form, and on a grid. float64.
//
// A step takes four velocities and 18 flops for each component. The ABC flow is three pairs of sine
// and cosine, of 2 + 1 + 6 flops to reduce the argument, 1 + 10 + 10 for the polynomials and 1 + 6
// at the end (core/sincos.h), and 3 each. A velocity on a grid is seven interpolations of four
// numbers (3 flops), which 12 find the cell for. A particle is read and written once for all steps
// of a call; the nodes are read once, for particles go cell by cell.
#include <numbers>
#include <vector>

#include "substep/core/random.h"
#include "substep/core/usize.h"
#include "substep/fields/flow_advection.h"
#include "substep/fields/grid_advection.h"
#include "work.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::fields;

std::vector<double> cloud(std::size_t n, double size) {
  std::vector<double> x;
  for (std::size_t i = 0; i < 3 * n; ++i) x.push_back(size * uniform2(5, i)[0]);
  return x;
}

void flow(benchmark::State& state) {
  const auto n = usize(state.range(0));
  const std::int64_t steps = state.range(1);
  const std::vector<double> x = cloud(n, 6.0);
  std::vector<double> moved(x.size());
  for (auto _ : state) {
    advect_flow<double>(Abc{}, "rk4", x.data(), moved.data(), state.range(0), {0, 1e-2, 0, steps},
                        1);
  }
  bench::report(state, {.items = static_cast<double>(state.range(0) * steps),
                        .bytes = 48.0 / static_cast<double>(steps),
                        .flops = 3 * 18 + 4 * (3 * 37 + 3 * 3),
                        .set = 48.0 * static_cast<double>(n),
                        .single = false});
}

void grid(benchmark::State& state) {
  constexpr std::size_t kNodes = 64;
  const auto n = usize(state.range(0));
  const std::int64_t steps = state.range(1);
  Axis axis;
  for (std::size_t i = 0; i < kNodes; ++i) axis.nodes.push_back(static_cast<double>(i));
  const Grid<double, 3> grid({axis, axis, axis}, false, 0);
  std::vector<double> values;
  for (std::size_t i = 0; i < 3 * kNodes * kNodes * kNodes; ++i) {
    values.push_back(uniform2(6, i)[0] - 0.5);
  }
  const Level<double> level = grid.pack(values.data(), 1);
  const Series<double> series{{&level}, {0.0}};
  std::vector<double> x = cloud(n, 20.0), stop(n, 0.0);
  for (double& coordinate : x) coordinate += 20;
  std::vector<std::int8_t> status(n, 0);
  std::vector<std::int32_t> order(n);
  sort_by_cell(grid, x.data(), state.range(0), order.data(), 1);
  const Particles<double> particles{x.data(), status.data(), stop.data(), order.data(),
                                    state.range(0)};
  for (auto _ : state) advect_grid(grid, "rk4", series, particles, {0, 1e-3, 0, steps}, 1);
  const double nodes = 32.0 * kNodes * kNodes * kNodes, of_particle = 48 + 1 + 4;
  const auto items = static_cast<double>(state.range(0) * steps);
  bench::report(state, {.items = items,
                        .bytes = (of_particle * static_cast<double>(n) + nodes / 27) / items,
                        .flops = 3 * 18 + 4 * (7 * 4 * 3 + 12),
                        .set = of_particle * static_cast<double>(n) + nodes / 27,
                        .single = false});
}

BENCHMARK(flow)
    ->Name("fields/abc")
    ->ArgNames({"n", "steps"})
    ->Args({1'000'000, 10})
    ->Unit(benchmark::kMillisecond);
BENCHMARK(grid)
    ->Name("fields/grid64")
    ->ArgNames({"n", "steps"})
    ->Args({1'000'000, 10})
    ->Unit(benchmark::kMillisecond);

}  // namespace
