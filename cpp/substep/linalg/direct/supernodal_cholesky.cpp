#include "substep/linalg/direct/supernodal_cholesky.h"

#include <algorithm>
#include <atomic>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/panel_kernels.h"
#include "substep/linalg/direct/supernodal_front.h"

namespace substep {
namespace {

constexpr std::int64_t kTasks = 48;  // a subtree of less than 1/kTasks of the work is a task
constexpr std::int64_t kGroup = 3;   // panels that a kernel computes together
// Panels of a front's columns that are eliminated together.
template <class Real>
constexpr std::int64_t kBlockPanels = 192 / kPanelRows<Real>;

template <bool kFirst, class Real>
void multiply_group(int count, const Real* const* a, const Real* b, std::int64_t k, Real* const* c,
                    std::int64_t columns) {
  if (count == 3) {
    multiply_panels<3, kFirst>(a, b, k, c, columns);
  } else if (count == 2) {
    multiply_panels<2, kFirst>(a, b, k, c, columns);
  } else {
    multiply_panels<1, kFirst>(a, b, k, c, columns);
  }
}

// Runs task(group) for groups of panels, in parallel where the work is worth a thread.
template <class Task>
void for_groups(std::int64_t groups, double flops, int threads, Task&& task) {
  if (threads == 1 || flops < 4e5 || groups < 2) {
    for (std::int64_t g = 0; g < groups; ++g) task(g);
  } else {
    parallel_chunks(groups, task, threads);
  }
}

// target[offsets[c] ...] += source[kPanel c ...] for kRows rows and the columns [begin, end).
template <int kRows, class Real>
void add_some_rows(const Real* source, const std::int64_t* offsets, std::int64_t begin,
                   std::int64_t end, Real* target) {
  for (std::int64_t c = begin; c < end; ++c) {
    Real sums[kRows];
    for (int r = 0; r < kRows; ++r) {
      sums[r] = target[offsets[c] + r] + source[kPanelRows<Real> * c + r];
    }
    for (int r = 0; r < kRows; ++r) target[offsets[c] + r] = sums[r];
  }
}

// The same for a number of rows, up to kPanel, that is known only now.
template <class Real>
void add_rows(std::int64_t rows, const Real* source, const std::int64_t* offsets,
              std::int64_t begin, std::int64_t end, Real* target) {
  [&]<int... kLess>(std::integer_sequence<int, kLess...>) {
    ((rows == kLess + 1 ? add_some_rows<kLess + 1>(source, offsets, begin, end, target) : void()),
     ...);
  }(std::make_integer_sequence<int, static_cast<int>(kPanelRows<Real>)>());
}

Supernodes checked_supernodes(const SparsePattern& lower, std::int32_t block, Ordering ordering) {
  check_pattern(lower);
  if (!is_lower(lower) || lower.rows != lower.cols || (block != 1 && block != 3) ||
      lower.cols % block != 0) {
    throw InputError(
        "lower: expected the lower triangle of a square matrix of 1 x 1 or 3 x 3 blocks");
  }
  return find_supernodes(lower, block, ordering);
}

}  // namespace

template <class Real>
SupernodalCholesky<Real>::~SupernodalCholesky() = default;

template <class Real>
SupernodalCholesky<Real>::SupernodalCholesky(const SparsePattern& lower, std::int32_t block,
                                             Ordering ordering)
    : SupernodalCholesky(lower, block, checked_supernodes(lower, block, ordering)) {}

template <class Real>
SupernodalCholesky<Real>::SupernodalCholesky(const SparsePattern& lower, std::int32_t block,
                                             Supernodes tree)
    : block_(block), tree_(std::move(tree)) {
  children_.resize(usize(tree_.count()));
  std::int64_t factor = 0, inverse = 0, update = 0;
  for (std::int64_t s = 0; s < tree_.count(); ++s) {
    Front f{};
    f.columns = block * tree_.columns(s);
    f.rows = block * tree_.row_count(s);
    f.pivots = panels<Real>(f.columns);
    f.below = panels<Real>(f.rows);
    f.factor = factor;
    f.inverse = inverse;
    f.update = update;
    for (std::int64_t c = 0; c < f.columns; ++c) {
      const double length = static_cast<double>(f.columns + f.rows - c);
      f.flops += length * length;
      nonzeros_ += f.columns + f.rows - c;
    }
    flops_ += f.flops;
    factor += (f.pivots + f.below) * f.columns * kPanel;
    inverse += f.columns;
    update += tree_.row_count(s);
    fronts_.push_back(f);
    if (tree_.parent[s] >= 0) {
      children_[tree_.parent[s]].push_back(static_cast<std::int32_t>(s));
    }
  }
  factor_.resize(usize(factor));
  inverses_.resize(usize(inverse));
  updates_.resize(usize(3 * update));
  solution_.resize(usize(lower.cols / block * 3));
  map_values(lower);
  choose_tasks();
}

// Where each entry of the matrix goes in the panels of its supernode.
template <class Real>
void SupernodalCholesky<Real>::map_values(const SparsePattern& lower) {
  const std::int32_t n = lower.cols;
  const auto &columns = lower.start, &rows = lower.row;
  std::vector<std::int32_t> node_of(tree_.order.size());
  for (std::int64_t s = 0; s < tree_.count(); ++s) {
    for (std::int32_t j = tree_.first[s]; j < tree_.first[s + 1]; ++j) {
      node_of[j] = static_cast<std::int32_t>(s);
    }
  }
  const auto place = [&](std::int32_t i) { return block_ * tree_.places[i / block_] + i % block_; };
  value_starts_.assign(usize(tree_.count()) + 1, 0);
  for (std::int32_t c = 0; c < n; ++c) {
    for (std::int32_t k = columns[c]; k < columns[c + 1]; ++k) {
      ++value_starts_[node_of[std::min(place(c), place(rows[k])) / block_] + 1];
    }
  }
  for (std::int64_t s = 0; s < tree_.count(); ++s) value_starts_[s + 1] += value_starts_[s];
  std::vector<std::int64_t> next(value_starts_.begin(), value_starts_.end() - 1);
  value_targets_.resize(rows.size());
  value_sources_.resize(rows.size());
  for (std::int32_t c = 0; c < n; ++c) {
    for (std::int32_t k = columns[c]; k < columns[c + 1]; ++k) {
      const std::int32_t low = std::min(place(c), place(rows[k]));
      const std::int32_t high = std::max(place(c), place(rows[k]));
      const std::int32_t s = node_of[low / block_];
      const Front& f = fronts_[s];
      const std::int64_t column = low - block_ * tree_.first[s];
      std::int64_t panel, r;
      if (high < block_ * tree_.first[s + 1]) {
        r = high - block_ * tree_.first[s];
        panel = r / kPanel;
      } else {
        const auto begin = tree_.rows.begin() + tree_.row_starts[s];
        const auto end = tree_.rows.begin() + tree_.row_starts[s + 1];
        r = block_ * (std::lower_bound(begin, end, high / block_) - begin) + high % block_;
        panel = f.pivots + r / kPanel;
      }
      value_targets_[next[s]] =
          static_cast<std::int32_t>((panel * f.columns + column) * kPanel + r % kPanel);
      value_sources_[next[s]++] = k;
    }
  }
}

// Subtrees of less than 1/kTasks of the work are tasks; the fronts above them come after.
template <class Real>
void SupernodalCholesky<Real>::choose_tasks() {
  std::vector<double> work(usize(tree_.count()));
  std::vector<std::int64_t> first(usize(tree_.count()));
  for (std::int64_t s = 0; s < tree_.count(); ++s) {
    work[s] += fronts_[s].flops + 1e3;
    first[s] = children_[s].empty() ? s : first[children_[s].front()];
    if (tree_.parent[s] >= 0) work[tree_.parent[s]] += work[s];
  }
  const double limit = flops_ / static_cast<double>(kTasks);
  kept_updates_.resize(usize(tree_.count()));
  for (std::int64_t s = 0; s < tree_.count(); ++s) {
    const std::int32_t p = tree_.parent[s];
    if (work[s] > limit) {
      top_.push_back(s);
    } else if (p < 0 || work[p] > limit) {
      task_roots_.push_back(s);
      task_first_.push_back(first[s]);
    } else {
      continue;
    }
    kept_updates_[s].resize(usize(fronts_[s].update_size()));
  }
}

// The columns of a front without its children: entries of the matrix, zeros elsewhere.
template <class Real>
void SupernodalCholesky<Real>::clear_columns(std::int64_t s, std::span<const double> values) {
  const Front& f = fronts_[s];
  Real* columns = factor_.data() + f.factor;
  const std::int64_t size = (f.pivots + f.below) * f.columns * kPanel;
  std::fill(columns, columns + size, Real(0));
  for (std::int64_t k = value_starts_[s]; k < value_starts_[s + 1]; ++k) {
    columns[value_targets_[k]] = static_cast<Real>(values[value_sources_[k]]);
  }
}

// Extend-add: the update matrix of a child into the columns of its parent, or into its update.
template <class Real>
void SupernodalCholesky<Real>::add_child(std::int64_t child, const Real* child_update,
                                         std::int64_t s, Part part, Real* update, int threads) {
  const Front &f = fronts_[s], &from = fronts_[child];
  const bool outer = part == Part::update;
  const std::int32_t* relative = tree_.relative.data() + tree_.row_starts[child];
  const std::int64_t own = tree_.columns(s);
  // Columns of the child that are columns of the front; the others are columns of its update.
  const std::int64_t inner =
      block_ * (std::lower_bound(relative, relative + tree_.row_count(child), own) - relative);
  const std::int64_t first = outer ? inner : 0, last = outer ? from.rows : inner;
  if (first == last) return;
  const auto local = [&](std::int64_t r) { return block_ * relative[r / block_] + r % block_; };
  thread_local std::vector<std::int64_t> column_of;
  column_of.resize(usize(from.rows));
  std::int64_t* offsets = column_of.data();
  for (std::int64_t c = first; c < last; ++c) {
    offsets[c] = kPanel * (outer ? local(c) - f.columns : local(c));
  }
  const std::int64_t p0 = first / kPanel;
  const auto work = static_cast<double>(8 * (from.below - p0) * kPanel * (last - first));
  for_groups(from.below - p0, work, threads, [&](std::int64_t g) {
    const std::int64_t p = p0 + g, end = std::min(kPanel * (p + 1), from.rows);
    for (std::int64_t r = std::max(first, kPanel * p), next; r < end; r = next) {
      // Rows [r, next) lie together in a panel of the parent, too.
      const bool pivots = local(r) < f.columns;
      const std::int64_t place = pivots ? local(r) : local(r) - f.columns;
      const std::int64_t lines = pivots ? f.columns - place : end - r;
      const std::int64_t most = r + std::min(kPanel - place % kPanel, lines);
      for (next = r + 1; next < std::min(end, most) && local(next) - local(r) == next - r;) ++next;
      Real* target = outer ? update + update_offset<Real>(place / kPanel)
                           : factor_.data() + f.factor +
                                 (place / kPanel + (pivots ? 0 : f.pivots)) * f.columns * kPanel;
      target += place % kPanel;
      const Real* source = child_update + update_offset<Real>(p) + r % kPanel;
      add_rows(next - r, source, offsets, first, std::min(last, r + 1), target);
      for (std::int64_t c = r + 1; c < std::min(last, next); ++c) {  // the triangle at their end
        for (std::int64_t k = c - r; k < next - r; ++k) {
          target[offsets[c] + k] += source[kPanel * c + k];
        }
      }
    }
  });
}

// Dense elimination of the columns of a front. Returns the first column that failed, or -1.
template <class Real>
std::int64_t SupernodalCholesky<Real>::eliminate(std::int64_t s, Real* update, int threads) {
  const Front& f = fronts_[s];
  Real* columns = factor_.data() + f.factor;
  Real* inverse = inverses_.data() + f.inverse;
  const std::int64_t stride = f.columns * kPanel, all = f.pivots + f.below;
  const auto panel = [&](std::int64_t p) { return columns + p * stride; };
  // Panels [p, p + count), in the columns of pivot panel b: minus the columns before; solve_panel()
  // is left to do.
  const auto reduce = [&](std::int64_t p, int count, std::int64_t b) {
    const std::int64_t width = std::min(kPanel, f.columns - kPanel * b);
    const Real* a[kGroup] = {};
    Real* c[kGroup] = {};
    for (int q = 0; q < count; ++q) {
      a[q] = panel(p + q);
      c[q] = panel(p + q) + kPanel * kPanel * b;
    }
    if (b > 0) multiply_group<false>(count, a, panel(b), kPanel * b, c, width);
    return width;
  };
  for (std::int64_t b0 = 0; b0 < f.pivots; b0 += kBlockPanels<Real>) {
    const std::int64_t b1 = std::min(f.pivots, b0 + kBlockPanels<Real>);
    for (std::int64_t b = b0; b < b1; ++b) {  // the triangle on the diagonal
      const std::int64_t width = reduce(b, 1, b);
      Real* block = panel(b) + kPanel * kPanel * b;
      const std::int64_t done = factorize_block(block, width, inverse + kPanel * b);
      if (done < width) return f.inverse + kPanel * b + done;
      for (std::int64_t p = b + 1; p < b1; p += kGroup) {
        const int count = static_cast<int>(std::min(kGroup, b1 - p));
        reduce(p, count, b);
        for (int q = 0; q < count; ++q) {
          solve_panel(panel(p + q) + kPanel * kPanel * b, block, inverse + kPanel * b, width);
        }
      }
    }
    const std::int64_t groups = (all - b1 + kGroup - 1) / kGroup;
    const double work = static_cast<double>((all - b1) * (b1 - b0) * (b1 + b0)) *
                        static_cast<double>(kPanel * kPanel * kPanel);
    for_groups(groups, work, threads, [&](std::int64_t g) {  // the rows below it
      const std::int64_t p = b1 + kGroup * g;
      const int count = static_cast<int>(std::min(kGroup, all - p));
      for (std::int64_t b = b0; b < b1; ++b) {
        const std::int64_t width = reduce(p, count, b);
        for (int q = 0; q < count; ++q) {
          solve_panel(panel(p + q) + kPanel * kPanel * b, panel(b) + kPanel * kPanel * b,
                      inverse + kPanel * b, width);
        }
      }
    });
  }
  const std::int64_t groups = (f.below + kGroup - 1) / kGroup;
  const double work =
      static_cast<double>(f.below * f.below * f.columns) * static_cast<double>(kPanel * kPanel);
  for_groups(groups, work, threads, [&](std::int64_t index) {  // the update matrix
    const std::int64_t p0 = kGroup * (groups - 1 - index);     // long rows first
    const std::int64_t p1 = std::min(p0 + kGroup, f.below);
    for (std::int64_t b = 0; b < p1; ++b) {
      const Real* a[kGroup] = {};
      Real* c[kGroup] = {};
      const std::int64_t first = std::max(p0, b);
      const int count = static_cast<int>(p1 - first);
      for (int q = 0; q < count; ++q) {
        a[q] = panel(f.pivots + first + q);
        c[q] = update + update_offset<Real>(first + q) + kPanel * kPanel * b;
      }
      multiply_group<true>(count, a, panel(f.pivots + b), f.columns, c, kPanel);
    }
  });
  return -1;
}

// Update matrices of a subtree are on two stacks, for even and odd depths: when a front is
// eliminated, those of its children are the last on one stack, and its own goes on the other.
template <class Real>
std::int64_t SupernodalCholesky<Real>::run_task(std::int64_t task, std::span<const double> values) {
  thread_local std::vector<Real> stacks[2];
  const std::int64_t root = task_roots_[task];
  std::vector<std::int64_t> offsets(usize(root - task_first_[task] + 1));
  std::vector<int> parity(offsets.size());
  std::int64_t top[2] = {0, 0}, need[2] = {0, 0};
  const auto local = [&](std::int64_t s) { return usize(s - task_first_[task]); };
  for (std::int64_t s = root - 1; s >= task_first_[task]; --s) {
    parity[local(s)] = 1 - parity[local(tree_.parent[s])];
  }
  for (std::int64_t s = task_first_[task]; s <= root; ++s) {
    const int mine = parity[local(s)];
    if (!children_[s].empty()) top[1 - mine] = offsets[local(children_[s].front())];
    offsets[local(s)] = top[mine];
    top[mine] += fronts_[s].update_size();
    need[mine] = std::max(need[mine], top[mine]);
  }
  for (int k = 0; k < 2; ++k) {
    if (static_cast<std::int64_t>(stacks[k].size()) < need[k]) {
      stacks[k].resize(usize(need[k]));
    }
  }
  for (std::int64_t s = task_first_[task]; s <= root; ++s) {
    const int mine = parity[local(s)];
    Real* update = s == root ? kept_updates_[s].data() : stacks[mine].data() + offsets[local(s)];
    const auto add_children = [&](Part part) {
      for (const std::int32_t child : children_[s]) {
        add_child(child, stacks[1 - mine].data() + offsets[local(child)], s, part, update, 1);
      }
    };
    clear_columns(s, values);
    add_children(Part::columns);
    const std::int64_t failed = eliminate(s, update, 1);
    if (failed >= 0) return failed;
    add_children(Part::update);
  }
  return -1;
}

template <class Real>
std::int64_t SupernodalCholesky<Real>::factorize(std::span<const double> values, int threads) {
  if (values.size() != value_sources_.size()) {
    throw InputError("values: expected one for each entry of the pattern");
  }
  const auto tasks = static_cast<std::int64_t>(task_roots_.size());
  std::vector<std::int64_t> failed(usize(tasks), -1);
  std::atomic<bool> stop{false};
  parallel_chunks(
      tasks,
      [&](std::int64_t task) {
        if (stop.load(std::memory_order_relaxed)) return;
        failed[task] = run_task(task, values);
        if (failed[task] >= 0) stop.store(true, std::memory_order_relaxed);
      },
      threads);
  const auto original = [&](std::int64_t column) {
    return block_ * tree_.order[column / block_] + column % block_;
  };
  for (const std::int64_t column : failed) {
    if (column >= 0) return original(column);
  }
  for (const std::int64_t s : top_) {
    Real* update = kept_updates_[s].data();
    const auto add_children = [&](Part part) {
      for (const std::int32_t child : children_[s]) {
        add_child(child, kept_updates_[child].data(), s, part, update, threads);
      }
    };
    clear_columns(s, values);
    add_children(Part::columns);
    const std::int64_t column = eliminate(s, update, threads);
    if (column >= 0) return original(column);
    add_children(Part::update);
  }
  return -1;
}

template class SupernodalCholesky<double>;
template class SupernodalCholesky<float>;

}  // namespace substep
