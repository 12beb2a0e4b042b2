// The fused fixed steps against single ones, over sizes around tiles and chunks.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "substep/core/random.h"
#include "substep/core/usize.h"
#include "substep/ode/symplectic/symplectic_solve.h"
#include "substep/ode/systems/chain.h"
#include "substep/ode/systems/chain_tiles.h"
#include "substep/ode/systems/nbody.h"
#include "substep/ode/systems/oscillators.h"

namespace substep::ode {
namespace {

std::vector<double> uniform(std::int64_t n, double low, double high, std::uint64_t stream) {
  std::vector<double> values(usize(n));
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = low + (high - low) * uniform2(7, i, stream)[0];
  }
  return values;
}

void expect_same_bits(System& system, std::int64_t n) {
  const auto x = uniform(n, -1, 1, 1), v = uniform(n, -1, 1, 2);
  for (int method = 0; method < static_cast<int>(kSymplecticMethods.size()); ++method) {
    SymplecticStepper single(system, method, x.data(), v.data(), 1);
    single.start(0);
    for (int k = 0; k < 53; ++k) single.step(0.1 * k, 0.1);
    for (const int threads : {1, 3}) {
      SymplecticStepper fused(system, method, x.data(), v.data(), threads);
      fused.start(0);
      ASSERT_TRUE(fused.run(0, 0.1, 0, 50));
      ASSERT_TRUE(fused.run(0, 0.1, 50, 3));
      EXPECT_EQ(single.state.y, fused.state.y) << "method " << method << ", n " << n;
      EXPECT_EQ(single.evaluations, fused.evaluations);
    }
  }
}

TEST(Symplectic, FusedStepsGiveTheBitsOfSingleSteps) {
  for (const std::int64_t n : {std::int64_t{1}, kTile - 1, kTile + 1, kChunk, kChunk + 1}) {
    Oscillators oscillators(uniform(n, 0.5, 1.5, 3));
    expect_same_bits(oscillators, n);
    for (const bool fixed : {true, false}) {
      SpringChain same(n, {0.7}, {1.3}, fixed);
      expect_same_bits(same, n);
      SpringChain varied(n, uniform(n + 1, 0.5, 1, 4), uniform(n, 1, 2, 5), fixed);
      expect_same_bits(varied, n);
    }
  }
}

TEST(Symplectic, OutputsAndStatus) {
  Oscillators oscillators({1.0, 2.0});
  const double x[] = {1, 1}, v[] = {0, 0}, times[] = {0.0, 0.33, 1.0};
  SecondOrderProblem problem{.method = kYoshida4,
                             .t0 = 0,
                             .t1 = 1,
                             .step = 0.01,
                             .x0 = x,
                             .v0 = v,
                             .every_step = false,
                             .t_eval = times};
  const SecondOrderSolution solution = solve_second_order(oscillators, problem);
  EXPECT_EQ(solution.status, SecondOrderSolution::kDone);
  EXPECT_EQ(solution.steps, 100);
  ASSERT_EQ(solution.t, std::vector<double>({0.0, 0.33, 1.0}));
  for (std::size_t k = 0; k < 3; ++k) {
    for (std::size_t i = 0; i < 2; ++i) {
      const double omega = 1.0 + static_cast<double>(i);
      EXPECT_NEAR(solution.x[2 * k + i], std::cos(omega * times[k]), 1e-7);
    }
  }
  problem.max_steps = 10;
  EXPECT_EQ(solve_second_order(oscillators, problem).status, SecondOrderSolution::kTooManySteps);
  problem.step = 1e-320;
  EXPECT_EQ(solve_second_order(oscillators, problem).status, SecondOrderSolution::kStepUnderflow);
}

TEST(NBody, ForcesAreMutual) {
  for (const int dimension : {2, 3}) {
    const std::int64_t n = 21;
    const auto masses = uniform(n, 0.5, 2, 1), x = uniform(n * dimension, -1, 1, 2);
    NBody system(masses, 1.3, 0.05, dimension);
    std::vector<double> a(x.size());
    system.acceleration(0, x.data(), nullptr, a.data());
    for (int axis = 0; axis < dimension; ++axis) {
      double total = 0, scale = 0;
      for (std::size_t i = 0; i < masses.size(); ++i) {
        const double force = masses[i] * a[i * usize(dimension) + usize(axis)];
        total += force;
        scale += std::abs(force);
      }
      EXPECT_LT(std::abs(total), 1e-14 * scale);
    }
  }
}

}  // namespace
}  // namespace substep::ode
