#include "substep/fields/any_grid.h"

#include "substep/core/errors.h"
#include "substep/fields/curvilinear_grid.h"
#include "substep/fields/grid.h"
#include "substep/fields/grid_advection.h"

namespace substep::fields {
namespace {

template <class Span, class Variant>
Span own(const Variant& numbers) {
  if (const auto* given = std::get_if<Span>(&numbers)) return *given;
  throw InputError("x: expected numbers of the grid's own precision");
}

template <class T>
struct LevelOf final : AnyLevel {
  explicit LevelOf(Level<T>&& packed) : level(std::move(packed)) {}
  Level<T> level;
};

template <class T>
Series<T> series_of(const AnySeries& given) {
  Series<T> series;
  for (const AnyLevel* level : given.levels) {
    const auto* known = dynamic_cast<const LevelOf<T>*>(level);
    if (known == nullptr) throw InputError("levels: expected some of the grid's own precision");
    series.levels.push_back(&known->level);
  }
  series.times = given.times;
  return series;
}

template <class G>
class GridOf final : public AnyGrid {
 public:
  using T = ScalarOf<G>;

  explicit GridOf(G grid) : grid_(std::move(grid)) {}

  std::int64_t level_bytes() const override {
    return grid_.node_count() * static_cast<std::int64_t>(sizeof(Node<T>));
  }
  std::unique_ptr<AnyLevel> pack(const double* values, int threads) const override {
    return std::make_unique<LevelOf<T>>(grid_.pack(values, threads));
  }
  void order(NumbersIn x, std::int32_t* out, int threads) const override {
    const auto in = own<std::span<const T>>(x);
    sort_by_cell(grid_, in.data(), rows(in), out, threads);
  }
  void velocity(const AnySeries& series, double t, NumbersIn x, NumbersOut u,
                int threads) const override {
    const auto in = own<std::span<const T>>(x);
    sample_grid(grid_, series_of<T>(series).at(t), in.data(), own<std::span<T>>(u).data(), rows(in),
                threads);
  }
  Events advect(const std::string& method, const AnySeries& series, const AnyParticles& given,
                const Steps& steps, int threads) const override {
    const auto x = own<std::span<T>>(given.x);
    const Series<T> levels = series_of<T>(series);
    const Particles<T> particles{x.data(), given.status.data(), given.stop_time.data(), given.order,
                                 rows(x)};
    return advect_grid(grid_, method, levels, particles, steps, threads);
  }

 private:
  template <class Span>
  static std::int64_t rows(const Span& x) {
    return static_cast<std::int64_t>(x.size()) / G::kDimension;
  }

  G grid_;
};

template <class G>
std::unique_ptr<AnyGrid> any(G grid) {
  return std::make_unique<GridOf<G>>(std::move(grid));
}

// make(number of the precision).
template <class Make>
std::unique_ptr<AnyGrid> of_precision(Precision precision, const Make& make) {
  return precision == Precision::kSingle ? make(float{}) : make(double{});
}

}  // namespace

std::unique_ptr<AnyGrid> make_grid(Precision precision, const std::vector<Axis>& axes, bool cubic,
                                   double radius) {
  return of_precision(precision, [&]<class T>(T) {
    return axes.size() == 2 ? any(Grid<T, 2>(axes, cubic, radius))
                            : any(Grid<T, 3>(axes, cubic, radius));
  });
}

std::unique_ptr<AnyGrid> make_curvilinear_grid(Precision precision, const Corners& corners,
                                               const std::vector<double>& z, Staggering staggering,
                                               double radius) {
  return of_precision(precision, [&]<class T>(T) {
    return z.empty() ? any(CurvilinearGrid<T, 2>(corners, z, staggering, radius))
                     : any(CurvilinearGrid<T, 3>(corners, z, staggering, radius));
  });
}

}  // namespace substep::fields
