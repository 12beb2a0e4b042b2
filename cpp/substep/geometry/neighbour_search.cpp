#include "substep/geometry/neighbour_search.h"

#include <span>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/neighbour_rows.h"
#include "substep/geometry/neighbours.h"

namespace substep::geometry {
namespace {

Pairs pairs(bool half) { return half ? Pairs::kHalf : Pairs::kFull; }

// Positions, and the same in cell order.
template <class Real>
class SearchOf final : public NeighbourSearch {
 public:
  SearchOf(std::span<const Real> rows, int columns)
      : near_(columns), x_(rows.size() / usize(columns)) {
    sorted_.resize(x_.size());
    const Real* row = rows.data();
    for (Point<Real>& p : x_) {
      p = {row[0], row[1], columns == 3 ? row[2] : Real{0}, Real{0}};
      row += columns;
    }
  }

  void search(double radius, int threads) override {
    const Real reach = static_cast<Real>(radius);
    near_.sort(x_, reach, threads);
    const std::int32_t* const order = near_.order().data();
    parallel_for(
        near_.size(), 16384,
        [&](std::int64_t begin, std::int64_t end) {
          for (auto k = usize(begin); k < usize(end); ++k) {
            sorted_[k] = x_[usize(order[k])];
          }
        },
        threads);
    near_.find(sorted_, reach, Pairs::kFull, threads);
  }
  std::int64_t bytes() const override { return static_cast<std::int64_t>(near_.bytes()); }
  std::int64_t pair_count() const override { return static_cast<std::int64_t>(near_.pair_count()); }
  void count_rows(bool half, std::int64_t* offsets, int threads) const override {
    geometry::count_rows(near_, pairs(half), offsets, threads);
  }
  void write_rows(bool half, const std::int64_t* offsets, std::int32_t* indices,
                  int threads) const override {
    geometry::write_rows(near_, pairs(half), offsets, indices, threads);
  }

 private:
  Neighbours<Real> near_;
  std::vector<Point<Real>> x_, sorted_;
};

}  // namespace

std::unique_ptr<NeighbourSearch> make_neighbour_search(NumbersIn points, int columns) {
  return std::visit(
      [&]<class Real>(std::span<const Real> rows) -> std::unique_ptr<NeighbourSearch> {
        return std::make_unique<SearchOf<Real>>(rows, columns);
      },
      points);
}

}  // namespace substep::geometry
