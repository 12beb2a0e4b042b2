#include "substep/pbd/groups/partition.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

template <class Real>
int longest_axis(std::span<const Point<Real>> x, std::span<const std::int32_t> ids) {
  constexpr Real kMost = std::numeric_limits<Real>::max();
  Real low[3] = {kMost, kMost, kMost}, high[3] = {-kMost, -kMost, -kMost};
  for (const std::int32_t i : ids) {
    const Real p[3] = {x[i].x, x[i].y, x[i].z};
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], p[k]);
      high[k] = std::max(high[k], p[k]);
    }
  }
  int axis = 0;
  for (int k = 1; k < 3; ++k) {
    if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
  }
  return axis;
}

template <class Real>
Real coordinate(const Point<Real>& p, int axis) {
  return axis == 0 ? p.x : axis == 1 ? p.y : p.z;
}

template <class Real>
void bisect(std::span<const Point<Real>> x, std::span<std::int32_t> ids, std::int64_t largest,
            std::vector<std::int64_t>& sizes) {
  const auto n = static_cast<std::int64_t>(ids.size());
  if (n <= largest) {
    std::sort(ids.begin(), ids.end());
    sizes.push_back(n);
    return;
  }
  const int axis = longest_axis(x, std::span<const std::int32_t>(ids));
  const auto before = [&](std::int32_t a, std::int32_t b) {
    const Real p = coordinate(x[a], axis), q = coordinate(x[b], axis);
    return p < q || (p == q && a < b);
  };
  std::nth_element(ids.begin(), ids.begin() + n / 2, ids.end(), before);
  bisect(x, ids.first(n / 2), largest, sizes);
  bisect(x, ids.subspan(n / 2), largest, sizes);
}

}  // namespace

std::int64_t Partition::patch_of(std::int64_t s) const {
  return std::upper_bound(patch_start.begin(), patch_start.end(), s) - patch_start.begin() - 1;
}

template <class Real>
Partition make_partition(std::span<const Point<Real>> x, std::int64_t largest) {
  Partition p;
  p.id.resize(x.size());
  p.slot.resize(x.size());
  std::iota(p.id.begin(), p.id.end(), 0);
  std::vector<std::int64_t> sizes;
  bisect(x, std::span(p.id), largest, sizes);
  p.patch_start.assign(1, 0);
  for (const std::int64_t n : sizes) p.patch_start.push_back(p.patch_start.back() + n);
  for (std::size_t k = 0; k < p.id.size(); ++k) {
    p.slot[usize(p.id[k])] = static_cast<std::int32_t>(k);
  }
  return p;
}

template Partition make_partition(std::span<const Point<float>>, std::int64_t);
template Partition make_partition(std::span<const Point<double>>, std::int64_t);

}  // namespace substep::pbd
