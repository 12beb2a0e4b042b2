#include "substep/gridfluid/pressure/regions.h"

#include <cmath>
#include <cstring>

#include "substep/core/usize.h"

namespace substep::gridfluid {
namespace {

constexpr std::int64_t kRuns = 512;  // that a task works on

// The run that stands for a set of runs (Tarjan 1975, with halved paths).
std::int32_t root(std::vector<std::int32_t>& parent, std::int32_t run) {
  while (parent[usize(run)] != run) {
    parent[usize(run)] = parent[usize(parent[usize(run)])];
    run = parent[usize(run)];
  }
  return run;
}

}  // namespace

template <class Real, int D>
void ClosedRegions<Real, D>::find(const FluidRows<D>& fluid,
                                  const std::array<std::span<const Real>, D>& w,
                                  std::span<const Cell> cells, int threads) {
  const Layout<D>& layout = fluid.layout();
  // Runs of joined cells, row by row, and whether air touches them.
  struct Slab {
    std::vector<Run> runs;  // region: 1 where air touches it
    std::vector<std::int32_t> row_runs;
  };
  const Slabs<D> bounds(fluid);
  std::vector<Slab> slabs(usize(bounds.count()));
  const auto is = [&](std::int64_t i, Cell kind) { return cells[usize(i)] == kind; };
  for_slabs(
      bounds,
      [&](std::int64_t s, int first, int last) {
        Slab& slab = slabs[usize(s)];
        for (int k = first; k < last; ++k)
          for_rows(fluid, k, [&](const Row<D>& row) {
            const std::size_t before = slab.runs.size();
            const std::int64_t end = row.at + row.length;
            const bool wraps = layout.periodic[D - 1];
            const auto* const kinds = reinterpret_cast<const unsigned char*>(cells.data());
            // Whether air is next to cells [begin, begin + n), at `other` and so on.
            const auto open = [&](std::int64_t other, std::int64_t n, const Real* face) {
              const void* const air =
                  std::memchr(kinds + other, static_cast<int>(Cell::kAir), usize(n));
              if (!air) return false;
              for (std::int64_t i = static_cast<const unsigned char*>(air) - (kinds + other); i < n;
                   ++i)
                if (face[i] > 0 && is(other + i, Cell::kAir)) return true;
              return false;
            };
            const Real* const along = w[D - 1].data();
            for (std::int64_t i = row.at; i < end;) {
              if (!is(i, Cell::kFluid)) {
                ++i;
                continue;
              }
              const std::int64_t begin = i++;
              while (i < end && is(i, Cell::kFluid) && along[i] > 0) ++i;
              const std::int64_t n = i - begin;
              bool air = open(wraps && begin == row.at ? end - 1 : begin - 1, 1, along + begin) ||
                         open(wraps && i == end ? row.at : i, 1, along + i);
              for (std::size_t a = 0; a < D - 1 && !air; ++a) {
                const std::int64_t offset = begin - row.at;
                air = open(row.below[a] + offset, n, w[a].data() + begin) ||
                      open(row.above[a] + offset, n, w[a].data() + row.above[a] + offset);
              }
              slab.runs.push_back({begin, static_cast<std::int32_t>(n), air});
            }
            slab.row_runs.push_back(static_cast<std::int32_t>(slab.runs.size() - before));
          });
      },
      threads);

  std::vector<Run> runs;
  std::vector<std::int32_t> row_begin{0}, parent;
  for (const Slab& slab : slabs) {
    runs.insert(runs.end(), slab.runs.begin(), slab.runs.end());
    for (const std::int32_t n : slab.row_runs) row_begin.push_back(row_begin.back() + n);
  }
  parent.resize(runs.size());
  for (std::size_t i = 0; i < runs.size(); ++i) parent[i] = static_cast<std::int32_t>(i);
  const auto join = [&](std::int32_t a, std::int32_t b) {
    a = root(parent, a), b = root(parent, b);
    if (a == b) return;
    if (b < a) std::swap(a, b);
    parent[usize(b)] = a;
    runs[usize(a)].region |= runs[usize(b)].region;
  };
  const int rows = D == 2 ? 1 : layout.cells[1];
  std::int64_t r = 0;
  for (int k = 0; k < layout.cells[0]; ++k)
    for_rows(fluid, k, [&](const Row<D>& row) {
      const std::int32_t mine = row_begin[usize(r)], end = row_begin[usize(r + 1)];
      if (layout.periodic[D - 1] && mine < end && runs[usize(mine)].begin == row.at &&
          runs[usize(end - 1)].begin + runs[usize(end - 1)].length == row.at + row.length &&
          w[D - 1][usize(row.at)] > 0)
        join(mine, end - 1);
      const int j = static_cast<int>(r % rows);
      for (std::size_t a = 0; a < D - 1; ++a) {
        const int index = a == 0 ? k : j, n = layout.cells[a];
        if (index == 0 && !layout.periodic[a]) continue;
        const std::int64_t step = a == 0 ? rows : 1;
        const std::int64_t other = r + (index == 0 ? n - 1 : -1) * step;
        const std::int64_t shift = row.at - row.below[a];
        std::int32_t p = mine, q = row_begin[usize(other)];
        const std::int32_t q_end = row_begin[usize(other + 1)];
        while (p < end && q < q_end) {
          const std::int64_t p0 = runs[usize(p)].begin, p1 = p0 + runs[usize(p)].length,
                             q0 = runs[usize(q)].begin + shift, q1 = q0 + runs[usize(q)].length;
          if (root(parent, p) != root(parent, q)) {
            for (std::int64_t i = std::max(p0, q0); i < std::min(p1, q1); ++i)
              if (w[a][usize(i)] > 0) {
                join(p, q);
                break;
              }
          }
          if (p1 < q1)
            ++p;
          else
            ++q;
        }
      }
      ++r;
    });

  runs_.clear(), cells_.clear();
  std::vector<std::int32_t> number(runs.size(), -1);
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const auto of = usize(root(parent, static_cast<std::int32_t>(i)));
    if (runs[of].region) continue;
    if (number[of] < 0) number[of] = static_cast<std::int32_t>(cells_.size()), cells_.push_back(0);
    runs_.push_back({runs[i].begin, runs[i].length, number[of]});
    cells_[usize(number[of])] += runs[i].length;
  }
  sums_.resize(runs_.size()), means_.resize(cells_.size());
}

template <class Real, int D>
std::size_t ClosedRegions<Real, D>::bytes() const {
  return runs_.capacity() * sizeof(Run) + (cells_.capacity() + sums_.capacity()) * 8;
}

template <class Real, int D>
template <class T>
double ClosedRegions<Real, D>::remove_means(std::span<T> values, int threads) {
  const auto n = static_cast<std::int64_t>(runs_.size());
  if (n == 0) return 0;
  parallel_for(
      n, kRuns,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const Run& run = runs_[usize(k)];
          double sum = 0;
          for (std::int64_t i = 0; i < run.length; ++i) sum += double(values[usize(run.begin + i)]);
          sums_[usize(k)] = sum;
        }
      },
      threads);
  std::fill(means_.begin(), means_.end(), 0);
  for (std::size_t k = 0; k < usize(n); ++k) means_[usize(runs_[k].region)] += sums_[k];
  double largest = 0;
  for (std::size_t region = 0; region < cells_.size(); ++region) {
    largest = std::max(largest, std::abs(means_[region]));
    means_[region] /= static_cast<double>(cells_[region]);
  }
  parallel_for(
      n, kRuns,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const Run& run = runs_[usize(k)];
          const double mean = means_[usize(run.region)];
          for (std::int64_t i = 0; i < run.length; ++i) {
            T& value = values[usize(run.begin + i)];
            value = static_cast<T>(double(value) - mean);
          }
        }
      },
      threads);
  return largest;
}

template class ClosedRegions<float, 2>;
template class ClosedRegions<float, 3>;
template class ClosedRegions<double, 2>;
template class ClosedRegions<double, 3>;
template double ClosedRegions<float, 2>::remove_means(std::span<float>, int);
template double ClosedRegions<float, 3>::remove_means(std::span<float>, int);
template double ClosedRegions<float, 2>::remove_means(std::span<double>, int);
template double ClosedRegions<float, 3>::remove_means(std::span<double>, int);
template double ClosedRegions<double, 2>::remove_means(std::span<double>, int);
template double ClosedRegions<double, 3>::remove_means(std::span<double>, int);

}  // namespace substep::gridfluid
