// Ten boxes on each other, a little askew: the stack settles, falls asleep, and stands as high as
// its boxes are; the ground carries their weight.
#include <cmath>
#include <cstdio>
#include <span>

#include "substep/rigid/world/world.h"

using namespace substep::rigid;

namespace {

constexpr int kBoxes = 10;
constexpr double kSide = 0.5, kStep = 1.0 / 60;  // [m], [s]

// A body of one fixture: mass, moments and principal axes are those of its shape and density.
std::int32_t add(World& world, Fixture fixture, const BodyState& at) {
  const std::span<Fixture> fixtures(&fixture, 1);
  const BodyState body = at.motion == Motion::kDynamic ? assemble(at, fixtures) : at;
  return world.add(body, fixtures);
}

}  // namespace

int main() {
  World world;
  add(world, {.shape = Plane{Vec3::UnitZ(), 0}, .local = {}}, {.motion = Motion::kStatic});
  std::int32_t top = -1;
  for (int k = 0; k < kBoxes; ++k) {
    const Vec3 position(0.02 * (k % 2), 0.01 * (k % 3), kSide * (k + 0.5) + 0.001);
    top =
        add(world, {.shape = Box{Vec3::Constant(kSide / 2)}, .local = {}}, {.position = position});
  }

  double carried = 0;  // by the ground, in the last step of a stack that is awake [N]
  while (world.time < 10 && !world.asleep(top)) {
    world.step(kStep);
    double impulse = 0;
    for (const ContactConstraint& contact : world.contacts()) {
      if (contact.a != 0 && contact.b != 0) continue;
      for (int k = 0; k < contact.count; ++k) impulse += contact.points[k].total;
    }
    if (impulse > 0) carried = impulse / kStep;
    if (world.steps % 15 == 1) {
      std::printf("%5.2f s: top at %.5f m, the ground carries %.1f N\n", world.time,
                  world.bodies().position(top).z() + kSide / 2, carried);
    }
  }
  const double height = world.bodies().position(top).z() + kSide / 2;
  const double weight = kBoxes * 1000 * kSide * kSide * kSide * 9.81;
  std::printf("%5.2f s: %s, %.5f m high, on the ground %.1f N of %.1f N\n", world.time,
              world.asleep(top) ? "asleep" : "awake", height, carried, weight);
  const bool stands = world.asleep(top) && std::abs(height - kBoxes * kSide) < 0.005;
  return stands && std::abs(carried / weight - 1) < 0.01 ? 0 : 1;
}
