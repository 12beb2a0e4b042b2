// What a step of rigid bodies pays before it knows any contact: the broad phase, the colours of the
// contacts, the islands; and what a ray costs.
//
// Boxes of half-size 0.1 m on a lattice, turned at random (their bounds are 0.14 m), where each
// sways about its place: by 5 mm, so that a few per cent leave their fat boxes in a step as in a
// pile that settles, or by 20 cm, as in one that falls. "per_item" is the time per body; the last
// number of a name is that of the threads. SUBSTEP_BENCH builds it.
#include <benchmark/benchmark.h>

#include <cmath>
#include <random>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/solver/graph_colouring.h"
#include "substep/rigid/solver/islands.h"
#include "substep/rigid/world/queries.h"

namespace {

using substep::usize;

using namespace substep::rigid;

class Pile {
 public:
  Pile(std::int32_t count, double sway) : sway_(sway) {
    const int side = static_cast<int>(std::ceil(std::cbrt(count)));
    std::mt19937 generator(1);
    std::uniform_real_distribution<double> draw(0, 6.28);
    for (std::int32_t i = 0; i < count; ++i) {
      places_.push_back(0.25 * Vec3(i % side, i / side % side, i / side / side + 0.6));
      phases_.push_back({draw(generator), draw(generator), draw(generator)});
      moving_.push_back(i);
    }
    bounds_.resize(places_.size());
    place(0);
    for (std::int32_t i = 0; i < count; ++i) {
      broad_phase.add(i, {i, Motion::kDynamic}, bounds_[usize(i)]);
    }
    broad_phase.add_plane(count, {-1, Motion::kStatic}, Vec3::UnitZ(), 0);
    for (int step = 0; step < 30; ++step) move(1);
  }

  // Half a second is one sway.
  void place(int step) {
    for (std::size_t i = 0; i < places_.size(); ++i) {
      const Vec3 angle = Vec3::Constant(0.21 * step) + phases_[i];
      const Vec3 at = places_[i] + sway_ * Vec3(angle.array().sin());
      bounds_[i] = {at - Vec3::Constant(0.14), at + Vec3::Constant(0.14)};
    }
  }
  void move(int threads) {
    place(++step_);
    broad_phase.update(moving_, bounds_, threads);
  }
  void update(int threads) { broad_phase.update(moving_, bounds_, threads); }
  void next() { place(++step_); }

  std::vector<BodyPair> contacts() const {
    const auto ground = static_cast<std::int32_t>(places_.size());
    std::vector<BodyPair> pairs;
    for (const FixturePair& pair : broad_phase.pairs()) {
      pairs.push_back({pair.a, pair.b == ground ? -1 : pair.b});
    }
    return pairs;
  }
  const std::vector<Vec3>& places() const { return places_; }
  Vec3 size() const { return places_.back(); }

  BroadPhase broad_phase;

 private:
  double sway_;
  int step_ = 0;
  std::vector<Vec3> places_, phases_;
  std::vector<std::int32_t> moving_;
  std::vector<Bounds> bounds_;
};

void per_item(benchmark::State& state) {
  state.counters["per_item"] = benchmark::Counter(
      static_cast<double>(state.range(0)),
      benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void update(benchmark::State& state, double sway) {
  Pile pile(static_cast<std::int32_t>(state.range(0)), sway);
  for (auto _ : state) {
    state.PauseTiming();
    pile.next();
    state.ResumeTiming();
    pile.update(static_cast<int>(state.range(1)));
  }
  per_item(state);
  state.counters["pairs"] = static_cast<double>(pile.broad_phase.pairs().size());
}

void colours(benchmark::State& state) {
  const auto bodies = static_cast<std::int32_t>(state.range(0));
  const auto contacts = Pile(bodies, 0.02).contacts();
  GraphColouring colouring;
  Sweep sweep;
  std::vector<std::uint8_t> colour;
  for (auto _ : state) {
    colour.assign(contacts.size(), GraphColouring::kNoColour);
    colouring.colour(contacts, bodies, colour);
    colouring.make_sweep(contacts, bodies, colour, 8, sweep);
  }
  per_item(state);
  state.counters["lanes_used"] =
      static_cast<double>(contacts.size()) / static_cast<double>(sweep.constraint.size());
}

// With one body that never sleeps, so that the islands are searched in every step.
void islands(benchmark::State& state) {
  const auto bodies = static_cast<std::int32_t>(state.range(0));
  const auto contacts = Pile(bodies, 0.02).contacts();
  Islands all;
  std::vector<double> speed(usize(bodies), 0.0);
  for (std::int32_t i = 0; i < bodies; ++i) all.add(i);
  speed.back() = 1;
  for (auto _ : state) all.update(0.02, {}, speed, contacts);
  per_item(state);
}

void rays(benchmark::State& state) {
  Pile pile(static_cast<std::int32_t>(state.range(0)), 0.02);
  const Shape ball = Sphere{0.12}, ground = Plane{Vec3::UnitZ(), 0};
  const auto plane = static_cast<std::int32_t>(state.range(0));
  const Scene scene{pile.broad_phase, [&](std::int32_t fixture) {
                      if (fixture == plane) return PlacedShape{&ground, {}};
                      const auto i = usize(fixture);
                      return PlacedShape{&ball, {pile.places()[i], Mat3(Mat3::Identity())}};
                    }};
  std::vector<Ray> all(1000);
  std::mt19937 generator(2);
  std::uniform_real_distribution<double> draw(0, 1);
  for (Ray& ray : all) {
    ray.origin = pile.size() + Vec3::Ones();
    const Vec3 to =
        Vec3(draw(generator), draw(generator), draw(generator)).cwiseProduct(pile.size());
    ray.direction = (to - ray.origin).normalized();
  }
  std::vector<FixtureHit> hits(all.size());
  for (auto _ : state) cast_rays(scene, all, ~0u, hits, 1);
  state.counters["per_ray"] = benchmark::Counter(
      static_cast<double>(all.size()),
      benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void sizes(benchmark::internal::Benchmark* b) {
  for (const int n : {100, 1000, 10000, 30000}) {
    for (const int threads : {1, 2}) b->Args({n, threads});
  }
  b->Unit(benchmark::kMicrosecond)->UseRealTime();
}
void serial(benchmark::internal::Benchmark* b) {
  for (const int n : {100, 1000, 10000, 30000}) b->Arg(n);
  b->Unit(benchmark::kMicrosecond);
}

BENCHMARK_CAPTURE(update, settling, 0.005)->Apply(sizes)->Name("rigid/broad_phase/settling");
BENCHMARK_CAPTURE(update, falling, 0.2)->Apply(sizes)->Name("rigid/broad_phase/falling");
BENCHMARK(colours)->Apply(serial)->Name("rigid/colours");
BENCHMARK(islands)->Apply(serial)->Name("rigid/islands");
BENCHMARK(rays)->Apply(serial)->Name("rigid/rays");

}  // namespace
