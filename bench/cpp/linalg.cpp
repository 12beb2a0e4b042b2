// Sparse matrices: factorization and solution by our own supernodal Cholesky and by CHOLMOD, and a
// product, of a net of vertices with 3 x 3 blocks.
//
// A factor is written once, and read once by each of the two substitutions; flops of a
// factorization are those that its analysis counted, of a substitution two for each entry.
#include <algorithm>
#include <utility>
#include <vector>

#include "substep/core/random.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/supernodal_cholesky.h"
#include "work.h"

namespace {

using substep::usize;

using namespace substep;

struct Problem {
  SparsePattern lower;
  std::vector<double> values;
};

// Vertices of a width x width net, each coupled with eight neighbours, diagonally dominant.
Problem net(std::int32_t width) {
  std::vector<std::pair<std::int32_t, std::int32_t>> pairs;
  const auto couple = [&](std::int32_t i, std::int32_t j) {
    for (std::int32_t r = 0; r < 3; ++r) {
      for (std::int32_t c = 0; c < 3; ++c) {
        const std::int32_t a = 3 * std::max(i, j) + r, b = 3 * std::min(i, j) + c;
        if (a >= b) pairs.emplace_back(a, b);
      }
    }
  };
  for (std::int32_t y = 0; y < width; ++y) {
    for (std::int32_t x = 0; x < width; ++x) {
      const std::int32_t i = y * width + x;
      couple(i, i);
      if (x + 1 < width) couple(i, i + 1);
      if (y + 1 < width) couple(i, i + width);
      if (x + 1 < width && y + 1 < width) couple(i, i + width + 1);
      if (x > 0 && y + 1 < width) couple(i, i + width - 1);
    }
  }
  const std::int32_t n = 3 * width * width;
  Problem p{build_pattern(n, n, pairs), {}};
  for (std::int32_t c = 0; c < n; ++c) {
    for (auto k = usize(p.lower.start[usize(c)]); k < usize(p.lower.start[usize(c) + 1]); ++k) {
      p.values.push_back(p.lower.row[k] == c ? 27.0 : uniform2(3, k)[0]);
    }
  }
  return p;
}

// An item is an entry of L.
bench::Work factorization(double entries, double flops) {
  return {
      .items = entries, .bytes = 8, .flops = flops / entries, .set = 8 * entries, .single = false};
}
bench::Work substitution(double entries) {
  return {.items = entries, .bytes = 16, .flops = 4, .set = 8 * entries, .single = false};
}

void factorize_own(benchmark::State& state) {
  const Problem p = net(static_cast<std::int32_t>(state.range(0)));
  SupernodalCholesky cholesky(p.lower, 3);
  for (auto _ : state) benchmark::DoNotOptimize(cholesky.factorize(p.values, 1));
  bench::report(state, factorization(static_cast<double>(cholesky.nonzeros()), cholesky.flops()));
}
void solve_own(benchmark::State& state) {
  const Problem p = net(static_cast<std::int32_t>(state.range(0)));
  SupernodalCholesky cholesky(p.lower, 3);
  cholesky.factorize(p.values, 1);
  std::vector<double> x(usize(p.lower.cols), 1.0);
  for (auto _ : state) {
    std::fill(x.begin(), x.end(), 1.0);
    cholesky.solve(x, 1);
  }
  bench::report(state, substitution(static_cast<double>(cholesky.nonzeros())));
}

CholeskyOptions in_blocks() {
  CholeskyOptions options;
  options.block = 3;
  return options;
}
void factorize_cholmod(benchmark::State& state) {
  const Problem p = net(static_cast<std::int32_t>(state.range(0)));
  Cholesky cholesky(p.lower, in_blocks());
  for (auto _ : state) cholesky.factor(p.values);
  bench::report(state, factorization(cholesky.report().factor_entries, cholesky.report().flops));
}
void solve_cholmod(benchmark::State& state) {
  const Problem p = net(static_cast<std::int32_t>(state.range(0)));
  Cholesky cholesky(p.lower, in_blocks());
  cholesky.factor(p.values);
  std::vector<double> b(usize(p.lower.cols), 1.0), x(b.size());
  for (auto _ : state) cholesky.solve(b, x);
  bench::report(state, substitution(cholesky.report().factor_entries));
}

// An item is an entry: its value and its row (12 bytes), a product and a sum.
void product(benchmark::State& state) {
  const Problem p = net(static_cast<std::int32_t>(state.range(0)));
  std::vector<double> x(usize(p.lower.cols), 1.0), y(x.size());
  for (auto _ : state) multiply_transposed<double>(p.lower, p.values, x, y);
  const auto entries = static_cast<double>(p.values.size());
  bench::report(state,
                {.items = entries, .bytes = 12, .flops = 2, .set = 12 * entries, .single = false});
}

void sizes(benchmark::internal::Benchmark* b) { b->Arg(100)->Unit(benchmark::kMillisecond); }

BENCHMARK(factorize_own)->Name("linalg/factorize/supernodal")->Apply(sizes);
BENCHMARK(factorize_cholmod)->Name("linalg/factorize/cholmod")->Apply(sizes);
BENCHMARK(solve_own)->Name("linalg/solve/supernodal")->Apply(sizes);
BENCHMARK(solve_cholmod)->Name("linalg/solve/cholmod")->Apply(sizes);
BENCHMARK(product)->Name("linalg/product")->Apply(sizes);

}  // namespace
