#include "substep/mpm/particles/particles.h"

#include <algorithm>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/radix_sort.h"
#include "substep/core/usize.h"
#include "substep/mpm/particles/packing.h"
#include "substep/mpm/particles/particle_rows.h"

namespace substep::mpm {
namespace {

using Entries = std::vector<KeyedIndex<std::uint64_t>>;

// Rows in ascending order of their blocks, otherwise as given.
template <class Real, int D>
Entries by_block(const ParticleRows<Real, D>& rows, int threads) {
  Entries entries(rows.blocks.size());
  std::uint64_t lowest = ~std::uint64_t{0}, highest = 0;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    entries[i] = {transfer::BlockKey<D>::pack(rows.blocks[i]), static_cast<std::int32_t>(i)};
    lowest = std::min(lowest, entries[i].key);
    highest = std::max(highest, entries[i].key);
  }
  if (entries.empty()) return entries;
  for (auto& entry : entries) entry.key -= lowest;
  int bits = 1;
  while (bits < 64 && (highest - lowest) >> bits != 0) ++bits;
  RadixSort<std::uint64_t>()(entries, bits, threads);
  for (auto& entry : entries) entry.key += lowest;
  return entries;
}

std::vector<std::uint64_t> keys_of(const std::vector<Entries>& groups) {
  std::vector<std::uint64_t> keys;
  for (const Entries& entries : groups) {
    for (const auto& entry : entries) {
      if (keys.empty() || keys.back() != entry.key) keys.push_back(entry.key);
    }
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  return keys;
}

template <class Real, int D>
void fill(ParticleGroup<Real, D>& group, const ParticleRows<Real, D>& rows, const Entries& entries,
          const std::vector<std::uint64_t>& keys, Order order, int threads) {
  constexpr int kWidth = kLanes<Real>, kMotion = ParticleGroup<Real, D>::kMotion;
  const int numbers = D + group.fields;
  std::vector<std::int32_t> counts;
  counts.reserve(keys.size());
  std::size_t next = 0;
  for (const std::uint64_t key : keys) {
    const std::size_t first = next;
    while (next < entries.size() && entries[next].key == key) ++next;
    counts.push_back(static_cast<std::int32_t>(next - first));
  }
  set_runs(group, counts);
  std::vector<std::size_t> first_entry(counts.size(), 0);
  for (std::size_t b = 1; b < counts.size(); ++b) {
    first_entry[b] = first_entry[b - 1] + usize(counts[b - 1]);
  }

  const auto slots = usize(group.packets) * kWidth;
  group.from.reset(slots);
  group.ids.reset(slots);
  group.volume.reset(slots);
  group.state.reset(slots * usize(group.stride()));
  group.other.reset(slots * usize(group.stride()));
  parallel_for(
      static_cast<std::int64_t>(counts.size()), 4,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<std::int16_t> cells;
        for (std::int64_t b = begin; b < end; ++b) {
          const Run& run = group.runs[usize(b)];
          if (run.count == 0) continue;
          const auto first = usize(run.first) * kWidth;
          cells.clear();
          for (std::int32_t i = 0; i < run.count; ++i) {
            const std::size_t entry = first_entry[usize(b)] + usize(i);
            const std::int32_t row = entries[entry].index;
            group.from[first + usize(i)] = row;
            cells.push_back(Cells<D>::where(&rows.state[usize(row) * usize(numbers)], 1).cell);
          }
          if (order == Order::kCells) {
            sort_by_cell<D>(&group.from[first], cells.data(), run.count);
          }
          fill_lanes<Real>(run, group.from.data());
          for (std::size_t l = 0; l < lanes<Real>(run); ++l) {
            const auto slot = static_cast<std::int64_t>(first + l);
            const auto row = usize(group.from[first + l]);
            const bool repeats = l >= usize(run.count);
            group.ids[first + l] = repeats ? -1 : rows.ids[row];
            group.volume[first + l] = rows.volume[row];
            Real* const state = group.packet(slot / kWidth) + slot % kWidth;
            for (int f = 0; f < numbers; ++f) {
              state[f * kWidth] = rows.state[row * usize(numbers) + usize(f)];
            }
            Real* const motion = group.motion(slot / kWidth) + slot % kWidth;
            for (int f = 0; f < kMotion; ++f) {
              motion[f * kWidth] = rows.motion[row * kMotion + usize(f)];
            }
          }
        }
      },
      threads);
}

}  // namespace

template <class Real, int D>
void assign(Particles<Real, D>& particles, std::span<const ParticleRows<Real, D>> rows, Order order,
            int threads) {
  std::vector<Entries> entries;
  for (const auto& group : rows) entries.push_back(by_block(group, threads));
  transfer::BlockLayout<D> layout;
  layout.assign(keys_of(entries));
  std::vector<ParticleGroup<Real, D>> groups(rows.size());
  for (std::size_t g = 0; g < rows.size(); ++g) {
    groups[g].carried = particles.flip_rate >= 0 ? groups[g].kCarried : 0;
    groups[g].fields = std::visit(
        [](const auto& material) {
          return std::remove_cvref_t<decltype(material)>::template kFields<D>;
        },
        particles.materials[g]);
    fill(groups[g], rows[g], entries[g], layout.particle_keys, order, threads);
  }
  particles.layout = std::move(layout);
  particles.groups = std::move(groups);
  particles.motion = true;
  particles.snapshot = {};
}

template <class Real, int D>
ParticleRows<Real, D> rows(const Particles<Real, D>& particles, std::size_t index) {
  constexpr int kWidth = kLanes<Real>;
  const ParticleGroup<Real, D>& group = particles.groups[index];
  ParticleRows<Real, D> rows;
  reserve(rows, usize(group.count), usize(D + group.fields));
  for (std::size_t b = 0; b < group.runs.size(); ++b) {
    const auto block = transfer::BlockKey<D>::unpack(particles.layout.particle_keys[b]);
    for (std::int32_t i = 0; i < group.runs[b].count; ++i) {
      const std::int64_t slot = group.runs[b].first * kWidth + i;
      const Real* const state = group.packet(slot / kWidth) + slot % kWidth;
      const Real* const motion = group.motion(slot / kWidth) + slot % kWidth;
      rows.blocks.push_back(block);
      for (int f = 0; f < D + group.fields; ++f) rows.state.push_back(state[f * kWidth]);
      for (int f = 0; f < group.kMotion; ++f) rows.motion.push_back(motion[f * kWidth]);
      rows.volume.push_back(group.volume[usize(slot)]);
      rows.ids.push_back(group.ids[usize(slot)]);
    }
  }
  return rows;
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                         \
  template void assign<Real, D>(Particles<Real, D>&, std::span<const ParticleRows<Real, D>>, \
                                Order, int);                                                 \
  template ParticleRows<Real, D> rows<Real, D>(const Particles<Real, D>&, std::size_t);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::mpm
