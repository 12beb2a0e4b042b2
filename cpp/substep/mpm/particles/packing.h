// Runs of packets, and the order of the particles within one: what sorting and building share.
#pragma once

#include <array>
#include <vector>

#include "substep/core/usize.h"
#include "substep/mpm/particles/cells.h"

namespace substep::mpm {

// Lanes of a run's packets, those that repeat included.
template <class Real>
std::size_t lanes(const Run& run) {
  return usize(run.packets) * kLanes<Real>;
}

// Runs of so many particles in each particle block, one after the other.
template <class Real, int D>
void set_runs(ParticleGroup<Real, D>& group, const std::vector<std::int32_t>& counts) {
  group.runs.clear();
  group.packets = group.count = 0;
  for (const std::int32_t count : counts) {
    const std::int32_t packets = (count + kLanes<Real> - 1) / kLanes<Real>;
    group.runs.push_back({group.packets, packets, count});
    group.packets += packets;
    group.count += count;
  }
}

// Orders the sources of a run's particles by cell, stably.
template <int D>
void sort_by_cell(std::int32_t* sources, const std::int16_t* cells, std::int32_t count) {
  std::array<std::int32_t, Cells<D>::kCells + 1> places{};
  const auto cell = [&](std::int32_t i) { return usize(cells[i]); };
  for (std::int32_t i = 0; i < count; ++i) ++places[cell(i) + 1];
  for (std::size_t c = 1; c < places.size(); ++c) places[c] += places[c - 1];
  const std::vector<std::int32_t> unsorted(sources, sources + count);
  for (std::int32_t i = 0; i < count; ++i) {
    sources[places[cell(i)]++] = unsorted[usize(i)];
  }
}

// The lanes after the last particle of a run get its source.
template <class Real>
void fill_lanes(const Run& run, std::int32_t* sources) {
  std::int32_t* const first = sources + run.first * kLanes<Real>;
  for (std::size_t l = usize(run.count); l < lanes<Real>(run); ++l) {
    first[l] = first[run.count - 1];
  }
}

}  // namespace substep::mpm
