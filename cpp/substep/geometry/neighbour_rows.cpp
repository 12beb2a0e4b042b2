#include "substep/geometry/neighbour_rows.h"

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::geometry {
namespace {

constexpr std::int64_t kGrain = 4096;  // points per task

// visit(i, list) for each point in cell order; i is its index before the sort.
template <class Real, class Visit>
void for_lists(const Neighbours<Real>& near, int threads, Visit&& visit) {
  parallel_for(
      near.size(), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          visit(near.order()[usize(k)], near[k]);
        }
      },
      threads);
}

}  // namespace

template <class Real>
void count_rows(const Neighbours<Real>& near, Pairs pairs, std::int64_t* offsets, int threads) {
  const std::int32_t* const order = near.order().data();
  for_lists(near, threads, [=](std::int32_t i, const NeighbourList& list) {
    std::int64_t count = list.count;
    if (pairs == Pairs::kHalf) {
      count = 0;
      for (std::int32_t k = 0; k < list.count; ++k) count += order[list.indices[k]] > i;
    }
    offsets[i + 1] = count;
  });
  offsets[0] = 0;
  for (std::int64_t i = 0; i < near.size(); ++i) offsets[i + 1] += offsets[i];
}

template <class Real>
void write_rows(const Neighbours<Real>& near, Pairs pairs, const std::int64_t* offsets,
                std::int32_t* indices, int threads) {
  const std::int32_t* const order = near.order().data();
  for_lists(near, threads, [=](std::int32_t i, const NeighbourList& list) {
    std::int32_t* out = indices + offsets[i];
    for (std::int32_t k = 0; k < list.count; ++k) {
      const std::int32_t j = order[list.indices[k]];
      if (pairs == Pairs::kFull || j > i) *out++ = j;
    }
  });
}

template void count_rows(const Neighbours<float>&, Pairs, std::int64_t*, int);
template void count_rows(const Neighbours<double>&, Pairs, std::int64_t*, int);
template void write_rows(const Neighbours<float>&, Pairs, const std::int64_t*, std::int32_t*, int);
template void write_rows(const Neighbours<double>&, Pairs, const std::int64_t*, std::int32_t*, int);

}  // namespace substep::geometry
