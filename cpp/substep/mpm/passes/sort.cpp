// Particles into blocks and cells: a counting sort, stable, over the few blocks that a particle can
// have reached since the last one.
#include <algorithm>
#include <cstring>
#include <iterator>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/mpm/particles/cells.h"
#include "substep/mpm/particles/packing.h"
#include "substep/mpm/passes/transfers.h"

namespace substep::mpm {
namespace {

constexpr std::int64_t kGrain = 4;  // blocks per task

// Calls each(slot, where) for the particles of a run, in order.
template <class Real, int D, class Each>
void for_each_particle(const ParticleGroup<Real, D>& group, const Run& run, Each&& each) {
  constexpr int kWidth = kLanes<Real>;
  for (std::int32_t i = 0; i < run.count; ++i) {
    const std::int64_t slot = run.first * kWidth + i;
    const Real* x = group.packet(slot / kWidth) + slot % kWidth;
    each(static_cast<std::int32_t>(slot), Cells<D>::where(x, kWidth));
  }
}

template <int D>
using Counts = std::array<std::int32_t, Cells<D>::kNeighbours>;

// How many particles of each block go to each of its neighbours.
template <class Real, int D>
std::vector<Counts<D>> count(const ParticleGroup<Real, D>& group, int threads) {
  std::vector<Counts<D>> counts(group.runs.size());
  parallel_for(
      static_cast<std::int64_t>(counts.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          const auto block = usize(b);
          counts[block].fill(0);
          for_each_particle(group, group.runs[block], [&](std::int32_t, auto where) {
            ++counts[block][usize(where.neighbour)];
          });
        }
      },
      threads);
  return counts;
}

// Keys of the blocks that particles are in now.
template <int D>
std::vector<std::uint64_t> occupied(const std::vector<std::uint64_t>& keys,
                                    const std::vector<std::vector<Counts<D>>>& counts) {
  std::vector<char> stays(keys.size(), 0);
  std::vector<std::uint64_t> fresh, from;
  for (int n = 0; n < Cells<D>::kNeighbours; ++n) {
    from.clear();
    for (std::size_t b = 0; b < keys.size(); ++b) {
      bool any = false;
      for (const auto& group : counts) any |= group[b][usize(n)] > 0;
      if (any) from.push_back(keys[b] + Cells<D>::offset(n));
    }
    std::size_t next = 0;
    transfer::match(from, 0, keys, [&](std::size_t i, std::size_t b) {
      fresh.insert(fresh.end(), from.begin() + static_cast<std::ptrdiff_t>(next),
                   from.begin() + static_cast<std::ptrdiff_t>(i));
      next = i + 1;
      stays[b] = 1;
    });
    fresh.insert(fresh.end(), from.begin() + static_cast<std::ptrdiff_t>(next), from.end());
  }
  std::sort(fresh.begin(), fresh.end());
  fresh.erase(std::unique(fresh.begin(), fresh.end()), fresh.end());
  std::vector<std::uint64_t> old, all;
  for (std::size_t b = 0; b < keys.size(); ++b) {
    if (stays[b]) old.push_back(keys[b]);
  }
  std::set_union(old.begin(), old.end(), fresh.begin(), fresh.end(), std::back_inserter(all));
  return all;
}

// The group in the new layout: from, runs, ids and volume, not yet the packets' numbers.
template <class Real, int D>
ParticleGroup<Real, D> reordered(const ParticleGroup<Real, D>& group,
                                 std::vector<Counts<D>>& counts,
                                 const std::vector<std::uint64_t>& before,
                                 const std::vector<std::uint64_t>& after, int threads) {
  // Counts become places: of a new block's particles, those of the lowest old block come first.
  std::vector<std::int32_t> filled(after.size(), 0);
  for (int n = Cells<D>::kNeighbours - 1; n >= 0; --n) {
    transfer::match(before, Cells<D>::offset(n), after, [&](std::size_t b, std::size_t a) {
      std::int32_t& place = counts[b][usize(n)];
      filled[a] += std::exchange(place, filled[a]);
    });
  }
  ParticleGroup<Real, D> sorted;
  sorted.fields = group.fields;
  sorted.carried = group.carried;
  set_runs(sorted, filled);

  const auto slots = usize(sorted.packets) * kLanes<Real>;
  sorted.from.reset(slots);
  sorted.ids.reset(slots);
  sorted.volume.reset(slots);
  AlignedBuffer<std::int16_t> cells;
  cells.reset(slots);
  for (int n = 0; n < Cells<D>::kNeighbours; ++n) {
    transfer::match(before, Cells<D>::offset(n), after, [&](std::size_t b, std::size_t a) {
      counts[b][usize(n)] += static_cast<std::int32_t>(sorted.runs[a].first * kLanes<Real>);
    });
  }
  parallel_for(
      static_cast<std::int64_t>(group.runs.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          const auto block = usize(b);
          for_each_particle(group, group.runs[block], [&](std::int32_t slot, auto where) {
            const auto place = usize(counts[block][usize(where.neighbour)]++);
            sorted.from[place] = slot;
            cells[place] = where.cell;
          });
        }
      },
      threads);

  parallel_for(
      static_cast<std::int64_t>(sorted.runs.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          const Run& run = sorted.runs[usize(b)];
          if (run.count == 0) continue;
          const auto first = usize(run.first) * kLanes<Real>;
          sort_by_cell<D>(&sorted.from[first], &cells[first], run.count);
          fill_lanes<Real>(run, sorted.from.data());
          for (std::size_t slot = first; slot < first + lanes<Real>(run); ++slot) {
            const auto source = usize(sorted.from[slot]);
            const bool repeats = slot >= first + usize(run.count);
            sorted.ids[slot] = repeats ? -1 : group.ids[source];
            sorted.volume[slot] = group.volume[source];
          }
        }
      },
      threads);
  return sorted;
}

template <class Real, int D>
std::size_t numbers(const ParticleGroup<Real, D>& group) {
  return usize(group.packets * group.stride() * kLanes<Real>);
}

// Room for n numbers. Those that there are stay, also where it throws.
template <class T>
void reserve(AlignedBuffer<T>& buffer, std::size_t n) {
  if (n * sizeof(T) <= buffer.bytes()) return;
  AlignedBuffer<T> larger;
  larger.reset(n);
  if (buffer.size() > 0) std::memcpy(larger.data(), buffer.data(), buffer.size() * sizeof(T));
  larger.reset(buffer.size());
  buffer.swap(larger);
}

// Packets of source, in the order of group.from, into target; positions (unless they are none) are
// counted from the new block's arena.
template <class Real, int D>
void gather(const ParticleGroup<Real, D>& group, const AlignedBuffer<Real>& source,
            AlignedBuffer<Real>& target, bool positions, int threads) {
  constexpr int kWidth = kLanes<Real>;
  const int fields = positions ? D + group.fields + group.carried : ParticleGroup<Real, D>::kMotion;
  const std::int64_t packet = group.stride() * kWidth;
  target.reset(numbers(group));
  parallel_for(
      group.packets, 64,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t p = begin; p < end; ++p) {
          const Real* lane[kWidth];
          for (int l = 0; l < kWidth; ++l) {
            const std::int32_t slot = group.from[usize(p * kWidth + l)];
            lane[l] = source.data() + slot / kWidth * packet + slot % kWidth;
          }
          Real* to = target.data() + p * packet;
          for (int f = 0; f < fields; ++f) {
            for (int l = 0; l < kWidth; ++l) to[f * kWidth + l] = lane[l][f * kWidth];
          }
          if (!positions) continue;
          for (int k = 0; k < D * kWidth; ++k) {
            const int neighbour = Cells<D>::axis(to[k]).neighbour;
            to[k] -= static_cast<Real>(transfer::kBlock * (neighbour - 1));
          }
        }
      },
      threads);
}

// What particles become. They themselves do not change until all the memory for it is there.
template <class Real, int D>
struct Sorted {
  transfer::BlockLayout<D> layout;
  std::vector<ParticleGroup<Real, D>> groups;

  Sorted(const Particles<Real, D>& particles, int threads);
  void replace(Particles<Real, D>& particles) {
    particles.layout = std::move(layout);
    particles.groups = std::move(groups);
  }
};

template <class Real, int D>
Sorted<Real, D>::Sorted(const Particles<Real, D>& particles, int threads) {
  std::vector<std::vector<Counts<D>>> counts;
  for (const auto& group : particles.groups) counts.push_back(count(group, threads));
  const std::vector<std::uint64_t>& before = particles.layout.particle_keys;
  layout.assign(occupied<D>(before, counts));
  for (std::size_t g = 0; g < particles.groups.size(); ++g) {
    groups.push_back(
        reordered(particles.groups[g], counts[g], before, layout.particle_keys, threads));
  }
}

}  // namespace

// All memory is taken first. g2p and rewind need none afterwards.
template <class Real, int D>
void sort(Particles<Real, D>& particles, Nodes<Real, D>& nodes, int threads,
          const std::function<void(const transfer::BlockLayout<D>&)>& prepare) {
  Sorted<Real, D> sorted(particles, threads);
  Nodes<Real, D> moved;
  const std::int64_t old_blocks = particles.layout.node_blocks(),
                     blocks = sorted.layout.node_blocks();
  const std::int64_t layers = layers_of(particles);
  moved.set_zero(layers * blocks, threads);
  transfer::match(particles.layout.node_keys, 0, sorted.layout.node_keys,
                  [&](std::size_t b, std::size_t a) {
                    for (std::int64_t layer = 0; layer < layers; ++layer) {
                      std::memcpy(moved.block(layer * blocks + static_cast<std::int64_t>(a)),
                                  nodes.block(layer * old_blocks + static_cast<std::int64_t>(b)),
                                  Nodes<Real, D>::kReals * sizeof(Real));
                    }
                  });
  for (std::size_t g = 0; g < sorted.groups.size(); ++g) {  // both: g2p, too, needs the other one
    reserve(particles.groups[g].state, numbers(sorted.groups[g]));
    reserve(particles.groups[g].other, numbers(sorted.groups[g]));
  }
  if (prepare) prepare(sorted.layout);
  for (std::size_t g = 0; g < sorted.groups.size(); ++g) {
    ParticleGroup<Real, D>&from = particles.groups[g], &to = sorted.groups[g];
    gather(to, from.state, from.other, true, threads);
    to.state.swap(from.other);
    to.other.swap(from.state);
  }
  sorted.replace(particles);
  nodes = std::move(moved);
  particles.motion = false;
  particles.snapshot = {true, particles.trial, particles.before};
}

template <class Real, int D>
void sort_at_rest(Particles<Real, D>& particles, int threads) {
  Sorted<Real, D> sorted(particles, threads);
  for (std::size_t g = 0; g < sorted.groups.size(); ++g) {
    ParticleGroup<Real, D>& to = sorted.groups[g];
    gather(to, particles.groups[g].state, to.state, true, threads);
    gather(to, particles.groups[g].other, to.other, false, threads);
  }
  sorted.replace(particles);
}

template <class Real, int D>
void rewind(Particles<Real, D>& particles, int threads) {
  for (auto& group : particles.groups) {
    if (particles.snapshot.sorted) {
      gather(group, group.other, group.state, true, threads);
    } else {
      group.state.swap(group.other);
    }
  }
  particles.trial = particles.snapshot.trial;
  particles.before = particles.snapshot.before;
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                        \
  template void sort<Real, D>(Particles<Real, D>&, Nodes<Real, D>&, int,                    \
                              const std::function<void(const transfer::BlockLayout<D>&)>&); \
  template void sort_at_rest<Real, D>(Particles<Real, D>&, int);                            \
  template void rewind<Real, D>(Particles<Real, D>&, int);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::mpm
