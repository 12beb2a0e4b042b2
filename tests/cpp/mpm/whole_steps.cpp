// Whatever comes between, a call leaves the state before it or after a whole step, with what came
// out of emitters and went into sinks; and goes on from there as if nothing had been.
#include <gtest/gtest.h>

#include <cstring>
#include <set>
#include <string>

#include "../core/failures.h"
#include "substep/core/usize.h"
#include "substep/mpm/solver/method.h"

namespace {

using namespace substep::mpm;
using substep::usize;
using substep::failures::at_each;
using substep::failures::Bytes;
using substep::failures::fail_allocation;
using substep::failures::interrupt_poll;
using substep::geometry::Collider;
using substep::geometry::Emitter;
using substep::geometry::ParticleFlow;

constexpr double kTick = 1.0 / 1024;  // a step [s]

struct Scene {
  int dimension = 2, order = 2;
  bool sinks = false, bounds = false;
  Integrator integrator = Integrator::kExplicit;
  int steps = 11;

  double end() const { return steps * kTick; }
};

struct Falling {
  std::vector<std::shared_ptr<Collider>> colliders;
  std::unique_ptr<Method> method;

  // All but what the obstacles were given, which is that of a call.
  std::string state() const {
    Bytes bytes;
    const MethodState s = method->state();
    const double clock[] = {s.clock.time,
                            s.clock.supplied,
                            s.clock.drift,
                            s.clock.before,
                            static_cast<double>(s.clock.next_id),
                            s.clock.trial ? 1.0 : 0.0};
    bytes.put(clock, 6);
    bytes.put_all(s.counts, s.ids, s.blocks);
    bytes.put_each(s.values, s.motion, s.volumes);
    for (const Vec3& f : s.forces) bytes.put(f.data(), 3);
    bytes.put_all(s.flow.layers, s.flow.absorbed);
    for (const auto& collider : colliders) {
      const auto pose = collider->state();
      bytes.put(pose.data(), 13);
    }
    return bytes.take();
  }
};

// A block that falls fast upon a moving floor, beside a jet: layers leave every four steps.
Falling falling(const Scene& scene) {
  Settings settings;
  settings.cell = 0.125;
  settings.order = scene.order;
  settings.integrator = scene.integrator;
  settings.step = kTick;
  settings.boundaries = {Boundary::kSeparate};
  settings.threads = 1;
  const int d = scene.dimension;
  settings.gravity = d == 2 ? Vec3(0, -10, 0) : Vec3(0, 0, -10);
  if (scene.bounds) {
    settings.bounds = {Vec3(-1, -1, -1), Vec3(1, 0.5, 1)};
    settings.on_escape = OnEscape::kRemove;
  }
  const Vec3 up = d == 2 ? Vec3(0, 1, 0) : Vec3(0, 0, 1);
  Falling made;
  made.colliders = {std::make_shared<Collider>(substep::geometry::Plane{up}, -0.1 * up)};
  made.colliders[0]->velocity = 0.5 * up;
  made.colliders[0]->friction = 0.3;
  ParticleFlow flow;
  if (!scene.bounds) {
    Emitter jet;
    jet.position = 0.5 * up;
    jet.direction = -up;
    jet.speed = 16;
    for (const double x : {-0.03125, 0.03125}) jet.offsets.push_back({x, 0, 0});
    jet.thickness = jet.speed * 4 * kTick;
    jet.volume = 1.0 / 256;
    flow.emitters = {jet};
    if (scene.sinks) {
      flow.sinks = {std::make_shared<Collider>(substep::geometry::Sphere{0.2}, 0.3 * up)};
    }
  }
  made.method =
      make_method(substep::Precision::kSingle, d, settings,
                  {{"neo_hookean", {{"density", 1000}, {"mu", 1e4}, {"lambda", 1e4}}}},
                  made.colliders, ParticleFlow(std::move(flow.emitters), std::move(flow.sinks)));
  std::vector<Vec3> x, v;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      x.push_back((0.04 + 0.0625 * i) * up + Vec3(-0.5 + 0.0625 * j, 0, 0));
      v.push_back((scene.bounds ? 20.0 : -20.0) * up + Vec3(2, 0, 0));
    }
  }
  const std::vector<std::int32_t> materials(x.size(), 0);
  const std::vector<double> volumes(x.size(), 1.0 / 256);
  made.method->add(x, v, materials, volumes);
  return made;
}

// The states between the steps of an advance.
std::vector<std::string> whole_steps(const Scene& scene) {
  const Falling it = falling(scene);
  std::vector<std::string> states = {it.state()};
  for (bool first = true; it.method->time() < scene.end(); first = false) {
    it.method->advance_once(scene.end(), first);
    states.push_back(it.state());
  }
  return states;
}

void expect_whole_steps(const Scene& scene, std::int64_t (*fail)(std::int64_t)) {
  const std::vector<std::string> states = whole_steps(scene);
  const std::set<std::string> allowed(states.begin(), states.end());
  std::set<std::string> met;
  const std::int64_t places = at_each(fail, [&](const auto& call) {
    const Falling it = falling(scene), twin = falling(scene);
    call([&] { it.method->advance(scene.end()); });
    const std::string left = it.state();
    ASSERT_TRUE(allowed.contains(left)) << "at " << it.method->time() / kTick << " steps";
    met.insert(left);
    twin.method->restore(it.method->state());
    *twin.colliders[0] = *it.colliders[0];
    it.method->advance(scene.end());
    twin.method->advance(scene.end());
    ASSERT_EQ(it.state(), twin.state());
    if (!scene.sinks) {
      ASSERT_EQ(it.state(), states.back());
    }
  });
  EXPECT_GT(places, 20);
  EXPECT_GE(met.size(), usize(scene.steps - 1));
}

class WholeSteps : public testing::TestWithParam<Scene> {};
INSTANTIATE_TEST_SUITE_P(Scenes, WholeSteps,
                         testing::Values(Scene{}, Scene{.dimension = 3}, Scene{.sinks = true},
                                         Scene{.bounds = true}, Scene{.order = 1},
                                         Scene{.order = 3, .sinks = true, .steps = 7},
                                         Scene{.integrator = Integrator::kImplicit, .steps = 3}));

TEST_P(WholeSteps, WhereMemoryRunsOut) { expect_whole_steps(GetParam(), &fail_allocation); }
TEST_P(WholeSteps, WhereTheUserInterrupts) { expect_whole_steps(GetParam(), &interrupt_poll); }

// One call, which is done or not.
template <class Call>
void expect_whole(const Scene& scene, const Call& change) {
  const Falling before = falling(scene), after = falling(scene);
  before.method->advance(3 * kTick);
  after.method->advance(3 * kTick);
  change(*after.method);
  for (const auto fail : {&fail_allocation, &interrupt_poll}) {
    at_each(fail, [&](const auto& call) {
      const Falling it = falling(scene);
      it.method->advance(3 * kTick);
      call([&] { change(*it.method); });
      if (it.state() == before.state()) change(*it.method);
      ASSERT_EQ(it.state(), after.state());
      const Falling twin = falling(scene);
      twin.method->restore(it.method->state());
      *twin.colliders[0] = *it.colliders[0];
      it.method->advance(scene.end());
      twin.method->advance(scene.end());
      ASSERT_EQ(it.state(), twin.state());
    });
  }
}

TEST(WholeCalls, OfSteps) {
  expect_whole({.sinks = true}, [](Method& it) { it.step(kTick / 2); });
  expect_whole({.order = 1}, [](Method& it) { it.step(kTick / 2); });
  expect_whole({.sinks = true}, [](Method& it) { it.step_by_limit(); });
}

TEST(WholeCalls, OfEdits) {
  const Vec3 vectors[] = {{-0.4, 0.2, 0}, {-0.3, 0.2, 0}};
  const std::int64_t places[] = {0, 3};
  const std::vector<double> numbers(8, 0.25);
  const std::int32_t materials[] = {0, 0};
  expect_whole({}, [&](Method& it) { it.add(vectors, vectors, materials, {numbers.data(), 2}); });
  expect_whole({}, [&](Method& it) { it.remove(places); });
  expect_whole({}, [&](Method& it) { it.set_positions(vectors, places); });
  expect_whole({}, [&](Method& it) { it.set_velocities(vectors, places); });
  expect_whole({}, [&](Method& it) { it.set_forces(vectors, places); });
  expect_whole({}, [&](Method& it) { it.set_affine(numbers, places); });
  const Falling other = falling({});
  const MethodState state = other.method->state();
  expect_whole({}, [&](Method& it) { it.restore(state); });
}

}  // namespace
