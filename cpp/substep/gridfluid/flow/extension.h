// What is in the fluid, carried on into the obstacles beside it, so that what looks there finds
// something like it: each number is the mean of its neighbours of the layers before.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {

template <int D>
class Extension {
 public:
  // unknown: the numbers to be found, of those of a block, in their order.
  void find(const Layout<D>& layout, const Block<D>& block, std::span<const std::int64_t> unknown,
            int layers) {
    steps_.clear();
    if (unknown.empty()) return;
    std::vector<std::uint8_t> known(usize(layout.size), 0);
    std::array<int, D> cell = block.from;
    do known[usize(layout.index(cell))] = 1;
    while (next_in_block(cell, block.from, block.to));
    for (const std::int64_t i : unknown) known[usize(i)] = 0;
    std::vector<std::int64_t> left(unknown.begin(), unknown.end()), later;
    for (int layer = 0; layer < layers && !left.empty(); ++layer) {
      const std::size_t first = steps_.size();
      later.clear();
      for (const std::int64_t i : left) {
        Step step{.index = i, .neighbours = 0, .count = 0};
        for (unsigned n = 0; n < 2 * D; ++n) {
          const std::int64_t j = i + offset(layout, n);
          if (j < 0 || j >= layout.size || !known[usize(j)]) continue;
          step.neighbours |= static_cast<std::uint8_t>(1U << n);
          ++step.count;
        }
        if (step.count > 0) {
          steps_.push_back(step);
        } else {
          later.push_back(i);
        }
      }
      for (std::size_t k = first; k < steps_.size(); ++k) known[usize(steps_[k].index)] = 1;
      left.swap(later);
    }
  }

  template <class T>
  void apply(const Layout<D>& layout, std::span<T> x) const {
    for (const Step& step : steps_) {
      T sum = 0;
      for (unsigned n = 0; n < 2 * D; ++n) {
        if (step.neighbours >> n & 1U) sum += x[usize(step.index + offset(layout, n))];
      }
      x[usize(step.index)] = sum / T(step.count);
    }
  }

 private:
  struct Step {
    std::int64_t index;
    std::uint8_t neighbours, count;
  };
  static std::int64_t offset(const Layout<D>& layout, unsigned n) {
    const std::int64_t s = layout.stride[n / 2];
    return n % 2 == 0 ? -s : s;
  }
  std::vector<Step> steps_;
};

}  // namespace substep::gridfluid
