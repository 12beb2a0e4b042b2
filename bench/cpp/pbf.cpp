// Position-based fluids: cells, lists of neighbours, and one iteration of the density constraint,
// of particles at random about a lattice, support of two spacings (about 33 neighbours), float32.
//
// Sorting reads and writes each particle's key and number (16 bytes), in two passes of the radix
// sort, and its position once (16). Lists are written: four bytes for each pair; of a candidate
// (27 cells hold 27 / (4/3 pi) = 6.4 times the neighbours) the distance is 8 flops.
// A sweep reads the lists and the positions and writes a row for each particle (16 + 16 bytes and
// 16 of walls); neighbours are read again from the cache. Flops of a pair (density.cpp): offset,
// r^2 and its root 3 + 6 + 5, q 2; multipliers have W (9), W' (4), its square (3), f (1) and the
// sums (1 + 6); corrections have W' (6), the pressure (1), f (2) and the sums (6), with the root
// estimated (1).
#include <vector>

#include "substep/core/random.h"
#include "substep/core/usize.h"
#include "substep/pbf/density.h"
#include "work.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::pbf;

class Block {
 public:
  explicit Block(int side) : density(options()) {
    for (int i = 0; i < side * side * side; ++i) {
      const auto number = static_cast<std::uint64_t>(i);
      const auto a = uniform2(7, 2 * number), b = uniform2(7, 2 * number + 1);
      const auto at = [&](int k, double jitter) { return static_cast<float>(k + 0.3 * jitter); };
      x.push_back({at(i % side, a[0]), at(i / side % side, a[1]), at(i / side / side, b[0]), 1});
    }
    unsorted = x;
    lists.sort(x, radius(), 1);
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = unsorted[usize(lists.order()[i])];
    }
    lists.find(x, radius(), geometry::Pairs::kFull, 1);
    walls.assign(x.size(), {0, 0, 0, 0});
    sums = walls;
    x.push_back(density.far_point());
    y = x;
  }
  static DensityOptions options() {
    DensityOptions o;
    o.relaxation = 1e-3;
    return o;
  }
  float radius() const { return static_cast<float>(density.radius()); }
  std::span<const Point<float>> points() const { return {x.data(), x.size() - 1}; }
  double count() const { return static_cast<double>(x.size() - 1); }
  double pairs() const { return static_cast<double>(lists.pair_count()); }

  DensityConstraint<float> density;
  geometry::Neighbours<float> lists;
  std::vector<Point<float>> unsorted, x, y, walls, sums;
};

void sort(benchmark::State& state) {
  Block block(static_cast<int>(state.range(0)));
  for (auto _ : state) block.lists.sort(block.unsorted, block.radius(), 1);
  const double bytes = 16 + 2 * 2 * 8;
  bench::report(state,
                {.items = block.count(), .bytes = bytes, .flops = 6, .set = bytes * block.count()});
}
void find(benchmark::State& state) {
  Block block(static_cast<int>(state.range(0)));
  for (auto _ : state) {
    block.lists.find(block.points(), block.radius(), geometry::Pairs::kFull, 1);
  }
  const double bytes = 4 + 16 * block.count() / block.pairs();
  bench::report(
      state,
      {.items = block.pairs(), .bytes = bytes, .flops = 6.4 * 8, .set = bytes * block.pairs()});
}
bench::Work of_pairs(const Block& block, double flops) {
  const double bytes = 4 + 48 * block.count() / block.pairs();
  return {.items = block.pairs(), .bytes = bytes, .flops = flops, .set = bytes * block.pairs()};
}
void multipliers(benchmark::State& state) {
  Block block(static_cast<int>(state.range(0)));
  for (auto _ : state) block.density.multipliers(block.x, block.lists, block.walls, block.y, 1);
  bench::report(state, of_pairs(block, 16 + 9 + 4 + 3 + 1 + 7));
}
void correct(benchmark::State& state) {
  Block block(static_cast<int>(state.range(0)));
  block.density.multipliers(block.x, block.lists, block.walls, block.y, 1);
  for (auto _ : state) {
    block.density.correct(block.y, block.lists, block.walls, block.x, block.sums, 1);
  }
  bench::report(state, of_pairs(block, 12 + 6 + 1 + 2 + 6));
}

void sizes(benchmark::internal::Benchmark* b) { b->Arg(50)->Unit(benchmark::kMillisecond); }

BENCHMARK(sort)->Name("pbf/sort")->Apply(sizes);
BENCHMARK(find)->Name("pbf/neighbour_lists")->Apply(sizes);
BENCHMARK(multipliers)->Name("pbf/multipliers")->Apply(sizes);
BENCHMARK(correct)->Name("pbf/corrections")->Apply(sizes);

}  // namespace
