// Rigid bodies: the narrow phase of pairs, the contact solver, and joints. float64. What a step
// pays before it knows any contact is in rigid_broad_phase.cpp.
//
// Paths of the narrow phase and of the joints branch on what they find, so that their flops are
// estimates, good to a factor of two:
//   two spheres   d, its length, the normal, two points                               30
//   two boxes     axes of each in the frame of the other 120, separations of 6 faces and 9
//                 crossings of edges 150, one face cut by another and reduced 300    570
//   two hulls     of 14 corners: some 8 steps of GJK with two supports (70 each), the faces that
//                 look at each other cut and reduced 400                            1600
//   a joint       in one of two iterations of Newton: its body and itself factored and solved
//                 for (joint_matrix.h) 72 + 108 + 63 + 162 + 160, gradients and rotation 200
// A contact in a sweep (contact_packet.cpp, solve_velocities): velocities in its frame 90, friction
// 70, residuals of four points 29, their block 32, impulses to bodies 111. It is read with its
// share of a packet, and two rows of bodies are read and written, each of which is in the cache for
// the other contacts of a body: once for each contact.
#include <memory>
#include <random>
#include <vector>

#include "substep/rigid/collision/narrow_phase.h"
#include "substep/rigid/solver/contact_solver.h"
#include "work.h"

namespace {

using namespace substep;
using namespace substep::rigid;

class Random {
 public:
  double number(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(generator_);
  }
  Vec3 vector(double size) {
    return {number(-size, size), number(-size, size), number(-size, size)};
  }
  Quaternion rotation() {
    return Quaternion(number(-1, 1), number(-1, 1), number(-1, 1), number(-1, 1)).normalized();
  }

 private:
  std::mt19937 generator_{1};
};

enum Kind { kSpheres, kBoxes, kHulls };

// Pairs that all touch or nearly do: b is moved along a random direction until it does not overlap
// any more by more than a tenth.
void narrow_phase(benchmark::State& state, Kind kind, double flops) {
  constexpr std::size_t kPairs = 512;
  constexpr double kMargin = 0.05;
  struct Pair {
    Shape a, b;
    Pose pose_a, pose_b;
  };
  Random draw;
  const auto shape = [&]() -> Shape {
    if (kind == kSpheres) return Sphere{draw.number(0.4, 0.6)};
    if (kind == kBoxes) return Box{Vec3::Constant(0.5) + draw.vector(0.1)};
    std::vector<Vec3> points;
    for (int k = 0; k < 14; ++k) points.push_back(0.6 * draw.vector(1).normalized());
    return std::make_shared<const ConvexHull>(points);
  };
  std::vector<Pair> pairs;
  while (pairs.size() < kPairs) {
    Pair pair{shape(), shape(), {Vec3::Zero(), draw.rotation()}, {}};
    const Vec3 way = draw.vector(1).normalized();
    for (double at = 2.5; at > 0.5; at -= 0.02) {
      pair.pose_b = {at * way, draw.rotation()};
      Manifold manifold;
      Cache cache;
      if (!collide(pair.a, pair.pose_a, pair.b, pair.pose_b, kMargin, manifold, cache)) continue;
      pairs.push_back(pair);
      break;
    }
  }
  std::vector<Manifold> manifolds(kPairs);
  for (auto _ : state) {
    for (std::size_t k = 0; k < kPairs; ++k) {
      Cache cache;
      const Pair& pair = pairs[k];
      manifolds[k].count = 0;
      collide(pair.a, pair.pose_a, pair.b, pair.pose_b, kMargin, manifolds[k], cache);
    }
    benchmark::ClobberMemory();
  }
  const double bytes = sizeof(Pair) + sizeof(Manifold);
  bench::report(
      state,
      {.items = kPairs, .bytes = bytes, .flops = flops, .set = bytes * kPairs, .single = false});
}

// Stacks of ten boxes; the argument is their number. An item is a contact in a sweep.
void contacts(benchmark::State& state) {
  constexpr int kHigh = 10;
  const Shape ground = Plane{Vec3::UnitZ(), 0}, box = Box{Vec3::Constant(0.5)};
  Bodies bodies;
  bodies.add({.motion = Motion::kStatic});
  std::vector<ContactConstraint> touching;
  for (int stack = 0; stack < state.range(0); ++stack) {
    for (int k = 0; k < kHigh; ++k) {
      const double mass = 1000, moment = mass / 6;
      const auto b = static_cast<std::int32_t>(bodies.add({.position = {2.0 * stack, 0, k + 0.5},
                                                           .mass = mass,
                                                           .inertia = Vec3::Constant(moment)}));
      const std::int32_t a = k == 0 ? 0 : b - 1;
      Manifold manifold;
      Cache cache;
      collide(k == 0 ? ground : box, bodies.pose(a), box, bodies.pose(b), 0.02, manifold, cache);
      touching.push_back(make_contact(manifold, a, bodies.pose(a), b, bodies.pose(b)));
    }
  }
  ContactSolver solver;
  const ContactOptions options;
  const auto step = [&] {
    solver.step(bodies, {0, 0, -9.81}, 1.0 / 60, touching, options, {}, {}, 1);
  };
  for (int k = 0; k < 20; ++k) step();  // impulses carry the stacks
  for (auto _ : state) step();
  const auto count = static_cast<double>(touching.size());
  const double bytes = sizeof(ContactPacket) / double(ContactPacket::kLanes) + 2 * sizeof(BodyRow);
  bench::report(state, {.items = count * options.substeps * options.sweeps,
                        .bytes = bytes,
                        .flops = 332,
                        .set = bytes * count,
                        .single = false});
}

// A hanging chain of so many links, all solved for together. An item is a joint in a sub-step.
void joints(benchmark::State& state) {
  Bodies bodies;
  std::vector<Joint> chain;
  for (int k = 0; k < state.range(0); ++k) {
    const auto a = static_cast<std::int32_t>(
        bodies.add({.position = {k + 0.5, 0, 0}, .mass = 1, .inertia = {0.01, 0.09, 0.09}}));
    chain.push_back(make_ball(bodies, a, k == 0 ? Joint::kWorld : a - 1, {double(k), 0, 0}));
  }
  ContactSolver solver;
  const ContactOptions options;
  const Bodies start = bodies;
  const std::vector<Joint> first = chain;
  int steps = 0;
  for (auto _ : state) {
    if (++steps % 60 == 0) bodies = start, chain = first;  // it swings for a second
    solver.step(bodies, {0, 0, -9.81}, 1.0 / 60, {}, options, {}, chain, 1);
  }
  const double bytes = sizeof(Joint) + 3 * sizeof(BodyRow);
  bench::report(state, {.items = static_cast<double>(chain.size()) * options.substeps,
                        .bytes = bytes,
                        .flops = 2 * (72 + 108 + 63 + 162 + 160 + 200),
                        .set = bytes * static_cast<double>(chain.size()),
                        .single = false});
}

BENCHMARK_CAPTURE(narrow_phase, spheres, kSpheres, 30)->Name("rigid/narrow_phase/spheres");
BENCHMARK_CAPTURE(narrow_phase, boxes, kBoxes, 570)->Name("rigid/narrow_phase/boxes");
BENCHMARK_CAPTURE(narrow_phase, hulls, kHulls, 1600)->Name("rigid/narrow_phase/hulls");
BENCHMARK(contacts)->Name("rigid/contacts")->Arg(100)->Unit(benchmark::kMicrosecond);
BENCHMARK(joints)->Name("rigid/joints")->Arg(100)->Unit(benchmark::kMicrosecond);

}  // namespace
