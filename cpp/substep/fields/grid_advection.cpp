#include "substep/fields/grid_advection.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "substep/core/usize.h"
#include "substep/fields/curvilinear_grid.h"
#include "substep/fields/grid.h"

namespace substep::fields {
namespace {

constexpr std::int64_t kGridChunk = 2048;  // particles of a parallel task
constexpr std::int64_t kGridTile = 64;     // particles that step together

template <class G>
SUBSTEP_INLINE auto load_row(const ScalarOf<G>* row) {
  typename G::V4 x{};
  for (int d = 0; d < G::kDimension; ++d) x[d] = row[d];
  return x;
}

template <class V>
bool finite(const V& x) {
  return std::isfinite(x[0]) && std::isfinite(x[1]) && std::isfinite(x[2]);
}

// Particles at sea that step together: stage by stage over all of them, so that the processor works
// on several at once (each alone is a chain of dependent operations).
template <class Method, class G>
class Tile {
 public:
  using T = ScalarOf<G>;
  using V4 = typename G::V4;
  using Weights = tableaux::WholeWeights<Method>;

  Tile(const G& grid, const Series<T>& series, const Particles<T>& particles, const Steps& steps,
       Events& events)
      : grid_(grid), series_(series), particles_(particles), steps_(steps), events_(events) {}

  void load(std::int64_t begin, std::int64_t end) {
    const Slice<T> start = series_.at(steps_.time(0));
    count_ = 0;
    for (std::int64_t i = begin; i < end; ++i) {
      const std::int64_t id = particles_.order ? particles_.order[i] : i;
      if (particles_.status[id] != 0) continue;
      id_[count_] = id;
      x_[count_] = load_row<G>(particles_.x + id * kDim);
      Place place = Place::kSea;
      hint_[count_] = {};
      k_[0][count_] = grid_.rate(start, x_[count_], place, hint_[count_]);
      if (place == Place::kSea) {
        ++count_;
      } else {
        rest(count_, 0, place);
      }
    }
  }

  void step(std::int64_t number) {
    std::fill_n(place_, count_, Place::kSea);
    for_each_stage([&]<int i>(Stage<i>) {
      const Slice<T> slice = series_.at(steps_.time(number) + Method::c[i] * steps_.h);
      for (int m = 0; m < count_; ++m)
        k_[i][m] = grid_.rate(slice, stage<i>(m), place_[m], hint_[m]);
    });
    const Slice<T> slice = series_.at(steps_.time(number + 1));
    for (int m = 0; m < count_; ++m) {
      next_[m] = end(m);
      k_[0][m] =
          grid_.rate(slice, next_[m], place_[m], hint_[m]);  // the first stage of the next step
    }
    for (int m = count_ - 1; m >= 0; --m) {
      if (__builtin_expect(place_[m] == Place::kSea, 1)) {
        x_[m] = next_[m];
        continue;
      }
      if (!finite(next_[m])) {
        events_.not_finite.note(number, id_[m]);
      } else {
        rest(m, number, place_[m]);
      }
      store(m);
      --count_;  // the last one, already moved, takes its place
      id_[m] = id_[count_];
      x_[m] = x_[count_];
      hint_[m] = hint_[count_];
      k_[0][m] = k_[0][count_];
    }
  }

  void store() const {
    for (int m = 0; m < count_; ++m) store(m);
  }
  bool empty() const { return count_ == 0; }

 private:
  static constexpr int kStages = Method::stages, kDim = G::kDimension;

  // Calls action(Stage<i>) for the stages i after the first, known to the compiler.
  template <int i>
  struct Stage {};
  template <class Action>
  SUBSTEP_INLINE static void for_each_stage(Action&& action) {
    [&]<int... i>(std::integer_sequence<int, i...>) {
      (action(Stage<i + 1>{}), ...);
    }(std::make_integer_sequence<int, kStages - 1>{});
  }

  template <int i>
  SUBSTEP_INLINE V4 stage(int m) const {
    V4 y = x_[m];
#pragma GCC unroll 4
    for (int j = 0; j < i; ++j) {
      if (Method::a[i][j] != 0) y = fma<V4>(T(steps_.h) * T(Method::a[i][j]), k_[j][m], y);
    }
    return y;
  }

  SUBSTEP_INLINE V4 end(int m) const {
    V4 sum = T(Weights::b[0]) * k_[0][m];
#pragma GCC unroll 4
    for (int i = 1; i < kStages; ++i) sum = fma<V4>(T(Weights::b[i]), k_[i][m], sum);
    V4 x = fma<V4>(T(steps_.h) / T(Weights::divisor), sum, x_[m]);
    x[3] = 0;  // the lane of the mask carries no position
    return x;
  }

  void rest(int m, std::int64_t number, Place place) {
    (place == Place::kLand ? events_.landed : events_.escaped).note(number, id_[m]);
    particles_.status[id_[m]] = static_cast<std::int8_t>(place);
    particles_.stop_time[id_[m]] = steps_.time(number);
  }

  void store(int m) const {
    for (int d = 0; d < kDim; ++d) particles_.x[id_[m] * kDim + d] = x_[m][d];
  }

  const G& grid_;
  const Series<T>& series_;
  const Particles<T>& particles_;
  const Steps& steps_;
  Events& events_;
  int count_ = 0;
  std::int64_t id_[kGridTile];
  Place place_[kGridTile];
  typename G::Hint hint_[kGridTile];
  alignas(64) V4 x_[kGridTile], next_[kGridTile], k_[kStages][kGridTile];
};

}  // namespace

template <class T>
Slice<T> Series<T>::at(double t) const {
  const auto after = std::upper_bound(times.begin(), times.end(), t) - times.begin();
  const auto i = usize(after);
  if (levels.size() == 1 || i == 0) return {levels.front(), nullptr, 0};
  if (i == times.size()) return {levels.back(), nullptr, 0};
  return {levels[i - 1], levels[i], T((t - times[i - 1]) / (times[i] - times[i - 1]))};
}

template <class Method, class G, class T = ScalarOf<G>>
static std::vector<Events> advect(const G& grid, const Series<T>& series,
                                  const Particles<T>& particles, const Steps& steps, int threads) {
  const auto chunks = usize((particles.count + kGridChunk - 1) / kGridChunk);
  std::vector<Events> events(chunks);
  parallel_for(
      particles.count, kGridChunk,
      [&](std::int64_t begin, std::int64_t end) {
        Tile<Method, G> tile(grid, series, particles, steps, events[usize(begin / kGridChunk)]);
        for (std::int64_t first = begin; first < end; first += kGridTile) {
          tile.load(first, std::min(first + kGridTile, end));
          for (std::int64_t s = 0; s < steps.count && !tile.empty(); ++s) tile.step(s);
          tile.store();
        }
      },
      threads);
  return events;
}

template <class G>
Events advect_grid(const G& grid, std::string_view method, const Series<ScalarOf<G>>& series,
                   const Particles<ScalarOf<G>>& particles, const Steps& steps, int threads) {
  std::vector<Events> events;
  with_method(method, [&]<class Method>(const Method&) {
    events = advect<Method>(grid, series, particles, steps, threads);
  });
  Events all;
  for (const Events& e : events) {
    all.landed.note(e.landed);
    all.escaped.note(e.escaped);
    all.not_finite.note(e.not_finite);
  }
  return all;
}

template <class G>
void sort_by_cell(const G& grid, const ScalarOf<G>* x, std::int64_t count, std::int32_t* order,
                  int threads) {
  std::vector<std::int32_t> key(usize(count));
  parallel_for(
      count, kGridChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          key[usize(i)] = static_cast<std::int32_t>(grid.block(load_row<G>(x + i * G::kDimension)));
        }
      },
      threads);
  std::vector<std::int32_t> place(usize(grid.block_count()) + 1, 0);
  for (const std::int32_t k : key) ++place[usize(k) + 1];
  for (std::size_t b = 1; b < place.size(); ++b) place[b] += place[b - 1];
  for (std::int64_t i = 0; i < count; ++i) {
    const auto k = usize(key[usize(i)]);
    order[place[k]++] = static_cast<std::int32_t>(i);
  }
}

template <class G>
void sample_grid(const G& grid, const Slice<ScalarOf<G>>& slice, const ScalarOf<G>* x,
                 ScalarOf<G>* u, std::int64_t count, int threads) {
  constexpr int kDim = G::kDimension;
  parallel_for(
      count, kGridChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          Place place = Place::kSea;
          const auto velocity = grid.velocity(slice, load_row<G>(x + i * kDim), place);
          for (int d = 0; d < kDim; ++d) {
            u[i * kDim + d] =
                place == Place::kSea ? velocity[d] : std::numeric_limits<ScalarOf<G>>::quiet_NaN();
          }
        }
      },
      threads);
}

#define SUBSTEP_GRID(G)                                                                            \
  template Events advect_grid(const G&, std::string_view, const Series<ScalarOf<G>>&,              \
                              const Particles<ScalarOf<G>>&, const Steps&, int);                   \
  template void sort_by_cell(const G&, const ScalarOf<G>*, std::int64_t, std::int32_t*, int);      \
  template void sample_grid(const G&, const Slice<ScalarOf<G>>&, const ScalarOf<G>*, ScalarOf<G>*, \
                            std::int64_t, int);
using D2 = Grid<double, 2>;
using D3 = Grid<double, 3>;
using F2 = Grid<float, 2>;
using F3 = Grid<float, 3>;
using CurvilinearD2 = CurvilinearGrid<double, 2>;
using CurvilinearD3 = CurvilinearGrid<double, 3>;
using CurvilinearF2 = CurvilinearGrid<float, 2>;
using CurvilinearF3 = CurvilinearGrid<float, 3>;
SUBSTEP_GRID(D2)
SUBSTEP_GRID(D3)
SUBSTEP_GRID(F2)
SUBSTEP_GRID(F3)
SUBSTEP_GRID(CurvilinearD2)
SUBSTEP_GRID(CurvilinearD3)
SUBSTEP_GRID(CurvilinearF2)
SUBSTEP_GRID(CurvilinearF3)
template struct Series<double>;
template struct Series<float>;

}  // namespace substep::fields
