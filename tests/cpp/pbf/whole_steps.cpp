// Whatever comes between, a call leaves the state before it or after it: a step with what came out
// of emitters and went into sinks; and goes on from there as if nothing had been.
#include <gtest/gtest.h>

#include <string>

#include "../core/failures.h"
#include "substep/pbf/liquid.h"

namespace {

using namespace substep::pbf;
using substep::failures::at_each;
using substep::failures::Bytes;
using substep::failures::fail_allocation;
using substep::failures::interrupt_poll;
using substep::geometry::Collider;
using substep::geometry::Emitter;
using substep::geometry::ParticleFlow;

struct Pouring {
  std::vector<std::shared_ptr<Collider>> colliders;
  std::unique_ptr<Liquid> liquid;

  std::string state() const {
    Bytes bytes;
    const LiquidState s = liquid->state();
    const double clock[] = {s.time, s.last_dt, static_cast<double>(s.next_id)};
    bytes.put(clock, 3);
    bytes.put_each(s.positions, s.velocities, s.forces);
    bytes.put_all(s.ids, s.fluids, s.flow.layers, s.flow.absorbed);
    for (const auto& collider : colliders) bytes.put_all(collider->state());
    return bytes.take();
  }
};

// With the ground lifted by so much after the first step.
Pouring pouring(double lifted = 0) {
  FluidOptions options;
  options.density.spacing = 0.1;
  options.forces.xsph = 0.1;
  options.forces.viscosity = {0.01};
  options.forces.vorticity_confinement = 0.1;
  options.forces.surface_tension = 0.01;
  options.masses = {1};
  options.warm_start = 0.5;
  options.threads = 1;
  options.bounds = {Vec3(-9, -9, -9), Vec3(9, 9, 0.29)};
  options.on_escape = OnEscape::kClamp;
  Pouring made;
  made.colliders = {
      std::make_shared<Collider>(substep::geometry::Plane{Vec3::UnitZ()}, Vec3(0, 0, 0.02))};
  made.colliders[0]->velocity = {0, 0, 0.5};
  made.colliders[0]->friction = 0.5;
  Emitter jet;
  jet.position = {0.15, 0.15, 0.6};
  jet.direction = -Vec3::UnitZ();
  jet.speed = 10;
  jet.offsets = {Vec3(0, 0, 0), Vec3(0.1, 0, 0)};
  jet.thickness = 0.1;
  const auto drain = std::make_shared<Collider>(substep::geometry::Sphere{0.1}, Vec3(0, 0, 0.1));
  made.liquid = make_liquid(substep::Precision::kSingle, Vec3::Zero(), made.colliders, options,
                            ParticleFlow({jet}, {drain}));
  std::vector<Vec3> x;
  for (int i = 0; i < 27; ++i) x.push_back(0.1 * Vec3(i % 3, i / 3 % 3, 0.5 + i / 9));
  const std::vector<Vec3> v(x.size(), Vec3(0.5, 0, -1));
  const std::vector<std::int32_t> fluids(x.size(), 0);
  made.liquid->add(x, v, fluids);
  made.liquid->step(0.005);
  made.colliders[0]->set_position(made.colliders[0]->position() + lifted * Vec3::UnitZ());
  return made;
}

template <class Call>
void expect_whole(const Call& change, double lifted = 0) {
  const Pouring before = pouring(lifted), after = pouring(lifted);
  change(*after.liquid);
  const std::string at_first = before.state(), done = after.state();
  ASSERT_NE(at_first, done);
  after.liquid->step(0.005);
  for (const auto fail : {&fail_allocation, &interrupt_poll}) {
    at_each(fail, [&](const auto& call) {
      const Pouring it = pouring(lifted);
      call([&] { change(*it.liquid); });
      if (it.state() == at_first) change(*it.liquid);
      ASSERT_EQ(it.state(), done);
      it.liquid->step(0.005);
      ASSERT_EQ(it.state(), after.state());
    });
  }
}

TEST(WholeCalls, OfAFluid) {
  const Vec3 vectors[] = {{0.4, 0.2, 0.2}, {0.3, 0.2, 0.2}};
  const std::int64_t places[] = {0, 3};
  const std::int32_t fluids[] = {0, 0};
  expect_whole([](Liquid& it) { it.step(0.02); });
  expect_whole([](Liquid& it) { it.step(0.02); }, 0.05);  // it covers particles
  expect_whole([&](Liquid& it) { it.add(vectors, vectors, fluids); });
  expect_whole([&](Liquid& it) { it.remove(places); });
  expect_whole([&](Liquid& it) { it.set_positions(vectors, places); });
  expect_whole([&](Liquid& it) { it.set_velocities(vectors, places); });
  expect_whole([&](Liquid& it) { it.set_forces(vectors, places); });
  const Pouring other = pouring();
  other.liquid->step(0.01);
  const LiquidState state = other.liquid->state();
  expect_whole([&](Liquid& it) { it.restore(state); });
}

}  // namespace
