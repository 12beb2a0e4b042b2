#include "substep/fields/grid_advection.h"

#include <algorithm>
#include <limits>

namespace substep::fields {
namespace {

constexpr std::int64_t kChunk = 2048;  // particles of a parallel task
constexpr int kTile = 128;             // particles that step together

template <class T, int kDim>
SUBSTEP_INLINE auto load_row(const T* row) {
  Vector<T, 4 * sizeof(T)> x{};
  for (int d = 0; d < kDim; ++d) x[d] = row[d];
  return x;
}

template <class V>
bool finite(const V& x) {
  return std::isfinite(x[0]) && std::isfinite(x[1]) && std::isfinite(x[2]);
}

// x after one step from x, whose rate is k0; `end` becomes the rate there.
template <class Method, class T, int kDim, class V>
SUBSTEP_INLINE V step_grid(const Grid<T, kDim>& grid, const Slice<T>* stage, T h, const V& x,
                           const V& k0, V& end, Place& place) {
  constexpr int kStages = Method::kStages;
  V k[kStages];
  k[0] = k0;
  V sum = T(Method::b[0]) * k0;
#pragma GCC unroll 4
  for (int i = 1; i < kStages; ++i) {
    V y = x;
#pragma GCC unroll 4
    for (int j = 0; j < i; ++j) {
      if (Method::a[i][j] != 0) y = fma<V>(h * T(Method::a[i][j]), k[j], y);
    }
    k[i] = grid.rate(stage[i], y, place);
    sum = fma<V>(T(Method::b[i]), k[i], sum);
  }
  V next = fma<V>(h / T(Method::divisor), sum, x);
  next[3] = 0;  // the lane of the mask carries no position
  end = grid.rate(stage[kStages], next, place);
  return next;
}

}  // namespace

template <class T>
Slice<T> Series<T>::at(double t) const {
  const auto after = std::upper_bound(times.begin(), times.end(), t) - times.begin();
  const auto i = static_cast<std::size_t>(after);
  if (levels.size() == 1 || i == 0) return {levels.front(), nullptr, 0};
  if (i == times.size()) return {levels.back(), nullptr, 0};
  return {levels[i - 1], levels[i], T((t - times[i - 1]) / (times[i] - times[i - 1]))};
}

template <class Method, class T, int kDim>
Events advect_grid(const Grid<T, kDim>& grid, const Series<T>& series,
                   const Particles<T>& particles, const Steps& steps, int threads) {
  using V4 = typename Grid<T, kDim>::V4;
  const auto chunks = static_cast<std::size_t>((particles.count + kChunk - 1) / kChunk);
  std::vector<Events> events(chunks);
  const auto run_tile = [&](std::int64_t first, int n, Events& found) {
    alignas(64) V4 x[kTile], k[kTile];
    std::int64_t id[kTile];
    int moving[kTile], count = 0;  // numbers in the tile of those still at sea
    const auto stop = [&](int i, std::int64_t step, Place place) {
      if (!finite(x[i])) return found.not_finite.note(step, id[i]);
      (place == Place::kLand ? found.landed : found.escaped).note(step, id[i]);
      particles.status[id[i]] = static_cast<std::int8_t>(place);
      particles.stop_time[id[i]] = steps.time(step);
    };
    const Slice<T> start = series.at(steps.time(0));
    for (int i = 0; i < n; ++i) {
      id[i] = particles.order ? particles.order[first + i] : first + i;
      x[i] = load_row<T, kDim>(particles.x + id[i] * kDim);
      if (particles.status[id[i]] != 0) continue;
      Place place = Place::kSea;
      k[i] = grid.rate(start, x[i], place);
      if (place == Place::kSea) {
        moving[count++] = i;
      } else {
        stop(i, 0, place);
      }
    }
    for (std::int64_t s = 0; s < steps.count && count > 0; ++s) {
      Slice<T> stage[Method::kStages + 1];
      for (int i = 0; i < Method::kStages; ++i) {
        stage[i] = series.at(steps.time(s) + Method::c[i] * steps.h);
      }
      stage[Method::kStages] = series.at(steps.time(s + 1));
      bool stopped = false;
      for (int m = 0; m < count; ++m) {
        const int i = moving[m];
        Place place = Place::kSea;
        V4 end;
        const V4 next = step_grid<Method>(grid, stage, T(steps.h), x[i], k[i], end, place);
        if (__builtin_expect(place != Place::kSea, 0)) {
          if (!finite(next)) x[i] = next;
          stop(i, s, place);
          moving[m] = -1;
          stopped = true;
        } else {
          x[i] = next;
          k[i] = end;
        }
      }
      if (stopped) count = static_cast<int>(std::remove(moving, moving + count, -1) - moving);
    }
    for (int i = 0; i < n; ++i) {
      for (int d = 0; d < kDim; ++d) particles.x[id[i] * kDim + d] = x[i][d];
    }
  };
  parallel_for(
      particles.count, kChunk,
      [&](std::int64_t begin, std::int64_t end) {
        Events& found = events[static_cast<std::size_t>(begin / kChunk)];
        for (std::int64_t first = begin; first < end; first += kTile) {
          run_tile(first, static_cast<int>(std::min<std::int64_t>(kTile, end - first)), found);
        }
      },
      threads);
  Events all;
  for (const Events& e : events) {
    all.landed.note(e.landed);
    all.escaped.note(e.escaped);
    all.not_finite.note(e.not_finite);
  }
  return all;
}

template <class T, int kDim>
void sort_by_cell(const Grid<T, kDim>& grid, const T* x, std::int64_t count, std::int32_t* order,
                  int threads) {
  std::vector<std::int32_t> key(static_cast<std::size_t>(count));
  parallel_for(
      count, kChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          key[static_cast<std::size_t>(i)] =
              static_cast<std::int32_t>(grid.block(load_row<T, kDim>(x + i * kDim)));
        }
      },
      threads);
  std::vector<std::int32_t> place(static_cast<std::size_t>(grid.block_count()) + 1, 0);
  for (const std::int32_t k : key) ++place[static_cast<std::size_t>(k) + 1];
  for (std::size_t b = 1; b < place.size(); ++b) place[b] += place[b - 1];
  for (std::int64_t i = 0; i < count; ++i) {
    const auto k = static_cast<std::size_t>(key[static_cast<std::size_t>(i)]);
    order[place[k]++] = static_cast<std::int32_t>(i);
  }
}

template <class T, int kDim>
void sample_grid(const Grid<T, kDim>& grid, const Slice<T>& slice, const T* x, T* u,
                 std::int64_t count, int threads) {
  parallel_for(
      count, kChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          Place place = Place::kSea;
          const auto velocity = grid.velocity(slice, load_row<T, kDim>(x + i * kDim), place);
          for (int d = 0; d < kDim; ++d) {
            u[i * kDim + d] =
                place == Place::kSea ? velocity[d] : std::numeric_limits<T>::quiet_NaN();
          }
        }
      },
      threads);
}

#define SUBSTEP_ADVECT(T, kDim, Method)                                                \
  template Events advect_grid<Method, T, kDim>(const Grid<T, kDim>&, const Series<T>&, \
                                               const Particles<T>&, const Steps&, int);
#define SUBSTEP_GRID(T, kDim)                                                                   \
  SUBSTEP_ADVECT(T, kDim, Euler)                                                                \
  SUBSTEP_ADVECT(T, kDim, Midpoint)                                                             \
  SUBSTEP_ADVECT(T, kDim, Heun)                                                                 \
  SUBSTEP_ADVECT(T, kDim, Rk4)                                                                  \
  template void sort_by_cell(const Grid<T, kDim>&, const T*, std::int64_t, std::int32_t*, int); \
  template void sample_grid(const Grid<T, kDim>&, const Slice<T>&, const T*, T*, std::int64_t, int);
SUBSTEP_GRID(double, 2)
SUBSTEP_GRID(double, 3)
SUBSTEP_GRID(float, 2)
SUBSTEP_GRID(float, 3)
template struct Series<double>;
template struct Series<float>;

}  // namespace substep::fields
