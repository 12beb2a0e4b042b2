// Regions of fluid that no air touches: their pressure is known but for a constant.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/grid/cells.h"
#include "substep/gridfluid/grid/rows.h"

namespace substep::gridfluid {

// Two fluid cells are of one region where a chain of faces with w > 0 joins them. A cell without
// any such face is a region of its own.
template <class Real, int D>
class ClosedRegions {
 public:
  void find(const FluidRows<D>& fluid, const std::array<std::span<const Real>, D>& w,
            std::span<const Cell> cells, int threads);

  int count() const { return static_cast<int>(cells_.size()); }
  std::size_t bytes() const;
  // Makes the mean over each region 0. Returns the largest |sum over a region|.
  template <class T>
  double remove_means(std::span<T> values, int threads);

 private:
  // Cells in a row.
  struct Run {
    std::int64_t begin;
    std::int32_t length, region;
  };
  std::vector<Run> runs_;
  std::vector<std::int64_t> cells_;  // of each region
  std::vector<double> sums_, means_;
};

}  // namespace substep::gridfluid
