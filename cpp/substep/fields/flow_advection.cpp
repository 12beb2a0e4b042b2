#include "substep/fields/flow_advection.h"

#include <atomic>
#include <cmath>
#include <limits>
#include <string>
#include <type_traits>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::fields {
namespace {

constexpr std::int64_t kFlowChunk = 2048;  // particles of a parallel task
constexpr int kFlowTile = 256;             // particles that step together

// One step of one vector of particles.
template <class Method, class V, class Flow, class Time, class Trig>
SUBSTEP_INLINE void step_flow(const Flow& flow, const Time* at, Lane<V> h, V* x, Trig& trig) {
  constexpr int kDim = Flow::kDimension, kStages = Method::stages;
  using T = Lane<V>;
  using Weights = tableaux::WholeWeights<Method>;
  V sum[kDim], k[kStages][kDim];
#pragma GCC unroll 4
  for (int i = 0; i < kStages; ++i) {
    V y[kDim];
#pragma GCC unroll 3
    for (int d = 0; d < kDim; ++d) {
      y[d] = x[d];
#pragma GCC unroll 4
      for (int j = 0; j < i; ++j) {
        if (Method::a[i][j] != 0) y[d] = fma(h * T(Method::a[i][j]), k[j][d], y[d]);
      }
    }
    flow.velocity(at[i], y, k[i], trig);
#pragma GCC unroll 3
    for (int d = 0; d < kDim; ++d) {
      const T b = T(Weights::b[usize(i)]);
      sum[d] = i == 0 ? b * k[i][d] : fma(b, k[i][d], sum[d]);
    }
  }
#pragma GCC unroll 3
  for (int d = 0; d < kDim; ++d) x[d] = fma(h / T(Weights::divisor), sum[d], x[d]);
}

// A method as data.
struct Table {
  int stages;
  const double *a, *b;  // a: row by row, of length `row`
  int row;
  double divisor;
};
constexpr int kMostStages = 16;
template <class Method>
constexpr Table table_of() {
  using Weights = tableaux::WholeWeights<Method>;
  static_assert(Method::stages <= kMostStages);
  return {Method::stages, &Method::a[0][0], Weights::b.data(),
          static_cast<int>(std::extent_v<decltype(Method::a), 1>), Weights::divisor};
}

// The same for arguments of any size, which are rare: one for all methods.
template <class V, class Flow, class Time>
[[gnu::noinline]] void step_flow_far(const Flow& flow, const Table& table, const Time* at,
                                     Lane<V> h, V* x) {
  constexpr int kDim = Flow::kDimension;
  using T = Lane<V>;
  Sincos<V> trig;
  V sum[kDim], k[kMostStages][kDim];
  for (int i = 0; i < table.stages; ++i) {
    V y[kDim];
    const double* const a = table.a + i * table.row;
    const T b = T(table.b[i]);
    for (int d = 0; d < kDim; ++d) {
      y[d] = x[d];
      for (int j = 0; j < i; ++j) {
        if (a[j] != 0) y[d] = fma(h * T(a[j]), k[j][d], y[d]);
      }
    }
    flow.velocity(at[i], y, k[i], trig);
    for (int d = 0; d < kDim; ++d) sum[d] = i == 0 ? b * k[i][d] : fma(b, k[i][d], sum[d]);
  }
  for (int d = 0; d < kDim; ++d) x[d] = fma(h / T(table.divisor), sum[d], x[d]);
}

template <class T, int kDim>
struct FlowTile {
  alignas(64) T x[kDim][kFlowTile] = {};

  Vector<T>& at(int d, std::int64_t i) { return *reinterpret_cast<Vector<T>*>(&x[d][i]); }

  void load(const T* rows, std::int64_t count) {
    for (std::int64_t i = 0; i < count; ++i) {
      for (int d = 0; d < kDim; ++d) x[d][i] = rows[i * kDim + d];
    }
  }
  void store(T* rows, std::int64_t count) const {
    for (std::int64_t i = 0; i < count; ++i) {
      for (int d = 0; d < kDim; ++d) rows[i * kDim + d] = x[d][i];
    }
  }
  // Number of the first particle that is not finite, or `count`.
  std::int64_t first_bad(std::int64_t count) const {
    for (std::int64_t i = 0; i < count; ++i) {
      for (int d = 0; d < kDim; ++d) {
        if (!std::isfinite(x[d][i])) return i;
      }
    }
    return count;
  }
};

// One step of a tile; called for all steps and, rarely, to find the one that failed.
template <class Method, class T, class Flow>
[[gnu::noinline]] void step_tile(const Flow& flow, double t, double h,
                                 FlowTile<T, Flow::kDimension>& tile, int count) {
  using V = Vector<T>;
  constexpr int kLanes = sizeof(V) / sizeof(T);
  decltype(flow.at(t)) at[Method::stages];
  for (int i = 0; i < Method::stages; ++i) at[i] = flow.at(t + Method::c[i] * h);
  const T step = static_cast<T>(h);
  for (int i = 0; i < count; i += kLanes) {
    V x[Flow::kDimension];
    for (int d = 0; d < Flow::kDimension; ++d) x[d] = tile.at(d, i);
    FastSincos<V> trig;
    step_flow<Method, V>(flow, at, step, x, trig);
    if (__builtin_expect(trig.was_beyond(), 0)) {
      V far[Flow::kDimension];
      for (int d = 0; d < Flow::kDimension; ++d) far[d] = tile.at(d, i);
      step_flow_far<V>(flow, table_of<Method>(), at, step, far);
      for (int d = 0; d < Flow::kDimension; ++d) x[d] = far[d];
    }
    for (int d = 0; d < Flow::kDimension; ++d) tile.at(d, i) = x[d];
  }
}

template <class T, class Flow>
using StepTile = void (*)(const Flow& flow, double t, double h, FlowTile<T, Flow::kDimension>& tile,
                          int count);

template <class T, class Flow>
void advect(const Flow& flow, StepTile<T, Flow> step_tile, const T* x, T* x_new, std::int64_t count,
            const Steps& steps, int threads) {
  constexpr int kDim = Flow::kDimension;
  std::atomic<bool> failed{false};
  const auto run = [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t first = begin; first < end; first += kFlowTile) {
      const int n = static_cast<int>(end - first < kFlowTile ? end - first : kFlowTile);
      FlowTile<T, kDim> tile;
      tile.load(x + first * kDim, n);
      for (std::int64_t s = 0; s < steps.count; ++s) {
        step_tile(flow, steps.time(s), steps.h, tile, n);
      }
      tile.store(x_new + first * kDim, n);
      if (tile.first_bad(n) < n) failed.store(true, std::memory_order_relaxed);
    }
  };
  parallel_for(count, kFlowChunk, run, threads);
  if (!failed) return;

  // Rare: find the first bad step by going through it again, one particle set after the other.
  std::int64_t worst_step = std::numeric_limits<std::int64_t>::max(), worst = -1;
  for (std::int64_t first = 0; first < count; first += kFlowTile) {
    const int n = static_cast<int>(count - first < kFlowTile ? count - first : kFlowTile);
    FlowTile<T, kDim> tile;
    tile.load(x + first * kDim, n);
    for (std::int64_t s = 0; s < steps.count && s < worst_step; ++s) {
      step_tile(flow, steps.time(s), steps.h, tile, n);
      if (const std::int64_t bad = tile.first_bad(n); bad < n) {
        worst_step = s;
        worst = first + bad;
      }
    }
  }
  throw NonFiniteError("position of particle " + std::to_string(worst) +
                           " is no longer finite in step " + std::to_string(worst_step) +
                           "; take a smaller step",
                       steps.time(worst_step), worst, worst_step);
}

}  // namespace

template <class T, class Flow>
void advect_flow(const Flow& flow, std::string_view method, const T* x, T* x_new,
                 std::int64_t count, const Steps& steps, int threads) {
  StepTile<T, Flow> step = nullptr;
  with_method(method, [&]<class Method>(const Method&) { step = step_tile<Method, T, Flow>; });
  advect<T, Flow>(flow, step, x, x_new, count, steps, threads);
}

template <class T, class Flow>
void sample_flow(const Flow& flow, double t, const T* x, T* u, std::int64_t count, int threads) {
  using V = Vector<T>;
  constexpr int kDim = Flow::kDimension, kLanes = sizeof(V) / sizeof(T);
  const auto at = flow.at(t);
  parallel_for(
      count, kFlowChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t first = begin; first < end; first += kFlowTile) {
          const std::int64_t n = end - first < kFlowTile ? end - first : kFlowTile;
          FlowTile<T, kDim> tile;
          tile.load(x + first * kDim, n);
          for (std::int64_t i = 0; i < n; i += kLanes) {
            V position[kDim], velocity[kDim];
            for (int d = 0; d < kDim; ++d) position[d] = tile.at(d, i);
            Sincos<V> trig;
            flow.velocity(at, position, velocity, trig);
            for (int d = 0; d < kDim; ++d) tile.at(d, i) = velocity[d];
          }
          tile.store(u + first * kDim, n);
        }
      },
      threads);
}

#define SUBSTEP_FLOW_OF(T, Flow)                                                       \
  template void advect_flow(const Flow&, std::string_view, const T*, T*, std::int64_t, \
                            const Steps&, int);                                        \
  template void sample_flow(const Flow&, double, const T*, T*, std::int64_t, int);
#define SUBSTEP_FLOW(Flow)      \
  SUBSTEP_FLOW_OF(double, Flow) \
  SUBSTEP_FLOW_OF(float, Flow)
SUBSTEP_FLOW(RigidRotation<2>)
SUBSTEP_FLOW(RigidRotation<3>)
SUBSTEP_FLOW(Shear<2>)
SUBSTEP_FLOW(Shear<3>)
SUBSTEP_FLOW(TaylorGreen)
SUBSTEP_FLOW(Abc)
SUBSTEP_FLOW(DoubleGyre)

}  // namespace substep::fields
