// The rows of a matrix for velocities of faces, and loops over rows by colour.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::gridfluid {

// Ordered by colours, of which no two rows meet. The numbers beside the diagonal are exact in
// float, and the diagonal is their sum and the mass: what is rigid feels the mass alone.
template <int D>
struct VelocityRows {
  // Others that a face meets: two along its axis, and across each of the other axes two of its own
  // component and four of the other.
  static constexpr int kWidth = 2 + 6 * (D - 1);

  std::int64_t size() const { return static_cast<std::int64_t>(diagonal.size()); }
  // To be filled: all that is not set is 0.
  void reset(std::size_t n) {
    diagonal.assign(n, 0.0);
    value.assign(n * kWidth, 0.0f);
    column.resize(n * kWidth);  // its own row: none yet
    for (std::size_t k = 0; k < column.size(); ++k)
      column[k] = static_cast<std::int32_t>(k / usize(kWidth));
    place.resize(n);
    component.resize(n);
  }
  // Adds to a number beside the diagonal.
  void add(std::int64_t row, std::int32_t with, double v) {
    std::int64_t k = row * kWidth;
    while (column[usize(k)] != row && column[usize(k)] != with) ++k;
    column[usize(k)] = with;
    value[usize(k)] += static_cast<float>(v);
  }
  // A row times x, without its own number.
  double others(std::int64_t row, std::span<const double> x) const {
    const float* const v = value.data() + row * kWidth;
    const std::int32_t* const c = column.data() + row * kWidth;
    double sum = 0;
    for (int k = 0; k < kWidth; ++k) sum += double(v[k]) * x[usize(c[k])];
    return sum;
  }

  std::array<int, D> cells{};  // of the grid
  std::array<bool, D> periodic{};
  std::vector<std::int64_t> colours;  // where each ends
  std::vector<double> diagonal;
  std::vector<float> value;  // kWidth each
  std::vector<std::int32_t> column;
  std::vector<std::array<float, D>> place;  // of the middle of the face, in cells
  std::vector<std::uint8_t> component;
};

// use(begin, end) of the rows of each colour, which end there, one colour after the other.
template <class Use>
void for_colours(const std::vector<std::int64_t>& ends, bool forwards, std::int64_t grain,
                 int threads, const Use& use) {
  const auto colours = static_cast<std::int64_t>(ends.size());
  const auto range = [&](std::int64_t phase) {
    const std::int64_t c = forwards ? phase : colours - 1 - phase;
    return std::array{c == 0 ? 0 : ends[usize(c - 1)], ends[usize(c)]};
  };
  std::vector<std::int64_t> chunks;
  for (std::int64_t phase = 0; phase < colours; ++phase) {
    const auto [begin, end] = range(phase);
    chunks.push_back((end - begin + grain - 1) / grain);
  }
  const auto run = [&](std::int64_t phase, std::int64_t chunk) {
    const auto [begin, end] = range(phase);
    use(begin + chunk * grain, std::min(begin + (chunk + 1) * grain, end));
  };
  parallel_phases(chunks, std::cref(run), threads);
}

}  // namespace substep::gridfluid
