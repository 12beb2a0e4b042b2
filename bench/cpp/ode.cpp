// Integrators: a small system whose steps are one loop, large ones that take many steps while a
// tile is in the cache, and implicit steps.
//
// increment() of a sum of m terms is 2 m + 1 flops, so a step of RK4 is 3 * 3 + 9 = 18 for each
// component, and 4 right-hand sides.
#include <vector>

#include "substep/core/usize.h"
#include "substep/ode/stepping/stepper.h"
#include "substep/ode/systems/chain.h"
#include "substep/ode/systems/oscillators.h"
#include "substep/ode/systems/stiff_systems.h"
#include "substep/ode/systems/systems.h"
#include "work.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::ode;

// Lorenz: 8 flops a right-hand side.
void rk4_small(benchmark::State& state) {
  Lorenz system(10, 28, 8.0 / 3);
  constexpr std::int64_t kSteps = 10000;
  double y[] = {1, 1, 1};
  for (auto _ : state) system.fixed_steps({"rk4", 0, 1e-5, kSteps, y, 1});
  bench::report(state, {.items = kSteps, .flops = 3 * 18 + 4 * 8, .single = false});
}

// Dormand and Prince's pair, of 6 new right-hand sides: sums of 1 to 5 and 5 terms, the error's 6,
// and its square over the scale (6). An item is a step that was tried.
void rk45_small(benchmark::State& state) {
  Lorenz system(10, 28, 8.0 / 3);
  const double start[] = {1, 1, 1};
  StepOptions options;
  options.t_bound = 20;
  options.y = start;
  options.rtol = options.atol = {1e-8};
  double steps = 0;
  for (auto _ : state) {
    const auto stepper = system.make_stepper("RK45", options);
    while (!stepper->finished()) stepper->step();
    steps = static_cast<double>(stepper->evaluations()) / 6;
  }
  const double sums = 2 * (1 + 2 + 3 + 4 + 5 + 5) + 6 + 2 * 6 + 6;
  bench::report(state, {.items = steps, .flops = 6 * 8 + 3 * sums, .single = false});
}

// x, v and omega are read, x and v written, once for all the steps of a call; 2 right-hand sides of
// one flop are none and one.
void rk4_oscillators(benchmark::State& state) {
  const auto n = usize(state.range(0)), steps = std::size_t(state.range(1));
  Oscillators system(std::vector<double>(n, 1.0));
  std::vector<double> y(2 * n, 1.0);
  for (auto _ : state) {
    system.fixed_steps({"rk4", 0, 1e-3, static_cast<std::int64_t>(steps), y.data(), 1});
  }
  bench::report(state, {.items = static_cast<double>(n * steps),
                        .bytes = 40.0 / static_cast<double>(steps),
                        .flops = 2 * 18 + 4,
                        .set = 24.0 * static_cast<double>(n),
                        .single = false});
}

// k / m (x_{i+1} - 2 x_i + x_{i-1}): 4 flops.
void rk4_chain(benchmark::State& state) {
  const auto n = usize(state.range(0)), steps = std::size_t(state.range(1));
  SpringChain system(state.range(0), {1.0}, {1.0}, true);
  std::vector<double> y(2 * n, 0.0);
  for (std::size_t i = 0; i < n; ++i) y[i] = static_cast<double>(i % 7);
  for (auto _ : state) {
    system.fixed_steps({"rk4", 0, 1e-3, static_cast<std::int64_t>(steps), y.data(), 1});
  }
  bench::report(state, {.items = static_cast<double>(n * steps),
                        .bytes = 32.0 / static_cast<double>(steps),
                        .flops = 2 * 18 + 4 * 4,
                        .set = 16.0 * static_cast<double>(n),
                        .single = false});
}

// Van der Pol's equation by Radau IIA: an item is an iteration of Newton, which is 3 right-hand
// sides (5 each), and for each of two components the stages (3), the residual (5 * 3 + 3 + 2 * 4),
// the update (3 + 5 * 2 + 1) and its norm (3 * 3); and the solution with a real and a complex 2 x 2
// matrix (6 + 28).
void radau_small(benchmark::State& state) {
  VanDerPol system(1000, 1);
  const double start[] = {2, 0};
  StepOptions options;
  options.t_bound = 2000;
  options.y = start;
  options.rtol = {1e-6};
  options.atol = {1e-8};
  double iterations = 0;
  for (auto _ : state) {
    const auto stepper = system.make_stepper("Radau", options);
    while (!stepper->finished()) stepper->step();
    iterations = static_cast<double>(stepper->evaluations()) / 3;
  }
  const double flops = 3 * 5 + 2 * (3 + 26 + 14 + 9) + 6 + 28;
  bench::report(state, {.items = iterations, .flops = flops, .single = false});
}

BENCHMARK(rk4_small)->Name("ode/rk4/lorenz");
BENCHMARK(rk45_small)->Name("ode/RK45/lorenz");
BENCHMARK(rk4_oscillators)
    ->Name("ode/rk4/oscillators")
    ->ArgNames({"n", "steps"})
    ->Args({1'000'000, 1})
    ->Args({1'000'000, 64})
    ->Unit(benchmark::kMicrosecond);
BENCHMARK(rk4_chain)
    ->Name("ode/rk4/chain")
    ->ArgNames({"n", "steps"})
    ->Args({1'000'000, 1})
    ->Args({1'000'000, 10})
    ->Unit(benchmark::kMicrosecond);
BENCHMARK(radau_small)->Name("ode/Radau/van_der_pol")->Unit(benchmark::kMicrosecond);

}  // namespace
