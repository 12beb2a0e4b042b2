// The roofs: what one core can compute, and move from each cache and from memory.
#include <algorithm>
#include <cstring>

#include "substep/core/aligned_buffer.h"
#include "substep/core/lanes.h"
#include "substep/core/usize.h"
#include "work.h"

namespace {

using substep::usize;

using namespace substep;

// Enough chains that the latency of an FMA (4 cycles, two a cycle) does not show.
template <class T>
void peak(benchmark::State& state) {
  using V = Vector<T>;
  constexpr int kChains = 12, kTimes = 1000, kLanes = sizeof(V) / sizeof(T);
  V chain[kChains];
  for (int k = 0; k < kChains; ++k) chain[k] = splat<V>(T(k));
  V a = splat<V>(T(0.999)), b = splat<V>(T(1e-3));
  benchmark::DoNotOptimize(a);
  benchmark::DoNotOptimize(b);
  for (auto _ : state) {
    for (int i = 0; i < kTimes; ++i) {
#pragma GCC unroll 12
      for (int k = 0; k < kChains; ++k) chain[k] = fma<V>(chain[k], a, b);
    }
    for (V& c : chain) benchmark::DoNotOptimize(c);
  }
  bench::report(state,
                {.items = double(kChains) * kTimes * kLanes, .flops = 2, .single = sizeof(T) == 4});
}

// a = b + s c (McCalpin, STREAM), of float64: 32 bytes, for a line of a is read before it is
// written. The argument is kilobytes of all three.
void triad(benchmark::State& state) {
  using V = Vector<double>;
  constexpr std::size_t kLanes = sizeof(V) / sizeof(double);
  const std::size_t n = usize(state.range(0)) * 1024 / 24 / kLanes * kLanes;
  AlignedBuffer<double> a, b, c;
  for (AlignedBuffer<double>* array : {&a, &b, &c}) {
    array->reset(n);
    std::fill_n(array->data(), n, 1.0);
  }
  V s = splat<V>(3.0);
  benchmark::DoNotOptimize(s);
  for (auto _ : state) {
    for (std::size_t i = 0; i < n; i += kLanes) {
      const V sum = fma<V>(s, load<V>(&c[i]), load<V>(&b[i]));
      std::memcpy(&a[i], &sum, sizeof sum);
    }
    benchmark::ClobberMemory();
  }
  const auto items = static_cast<double>(n);
  bench::report(state,
                {.items = items, .bytes = 32, .flops = 2, .set = 24 * items, .single = false});
}

BENCHMARK(peak<double>)->Name("roof/flops/float64");
BENCHMARK(peak<float>)->Name("roof/flops/float32");
BENCHMARK(triad)
    ->Name("roof/triad")
    ->Arg(24)
    ->Arg(512)
    ->Arg(2 * 1024)
    ->Arg(12 * 1024)
    ->Arg(24 * 1024)
    ->Arg(384 * 1024);

// The results' header names what the program was compiled for.
const bool kContext = [] {
  benchmark::AddCustomContext("level", SUBSTEP_LEVEL);
  benchmark::AddCustomContext("compiler", __VERSION__);
  return true;
}();

}  // namespace
