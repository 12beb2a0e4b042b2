#include "substep/rigid/world/batch.h"

#include <algorithm>

#include "substep/core/usize.h"

namespace substep::rigid {

Batch::Batch(std::span<const World* const> worlds) : ManyWorlds(worlds.size()) {
  for (const World* world : worlds) {
    worlds_.emplace_back(world->options()).restore(world->state());
  }
  keep_initial();
}

void Batch::keep_initial() {
  std::vector<WorldState> states;
  for (const World& world : worlds_) states.push_back(world.state());
  initial_ = std::move(states);
}

std::int64_t Batch::most_bodies() const {
  std::int64_t most = 0;
  for (const World& world : worlds_) most = std::max(most, world.bodies().size());
  return most;
}

void Batch::step(const Steps& steps) {
  force_.resize(worlds_.size());
  torque_.resize(worlds_.size());
  kept_.resize(worlds_.size());
  for (std::size_t w = 0; steps.hold_forces && w < worlds_.size(); ++w) {
    force_[w] = worlds_[w].bodies().force;
    torque_[w] = worlds_[w].bodies().torque;
  }
  steps_ = steps;
  run(steps.count);
}

void Batch::take_step(std::int64_t w, std::int64_t s) {
  World& world = worlds_[usize(w)];
  if (steps_.hold_forces) {
    world.bodies().force = force_[usize(w)];
    world.bodies().torque = torque_[usize(w)];
  }
  world.step(steps_.dt);
  const Frames& frames = steps_.frames;
  if ((s + 1) % frames.every == 0) record(w, (s + 1) / frames.every - 1, frames);
}

void Batch::done(std::int64_t steps) {
  for (std::int64_t s = 0; s < steps; ++s) time += steps_.dt;
}

void Batch::record(std::int64_t w, std::int64_t frame, const Frames& frames) const {
  if (frame >= frames.frames) return;
  const Bodies& bodies = worlds_[usize(w)].bodies();
  double* row = &frames.values[usize((w * frames.frames + frame) * frames.bodies * frames.columns)];
  for (std::int64_t i = 0; i < bodies.size(); ++i, row += frames.columns) {
    std::copy_n(&bodies.x[usize(3 * i)], 3, row);
    std::copy_n(&bodies.q[usize(4 * i)], 4, row + 3);
    if (frames.columns == 7) continue;
    Vec3::Map(row + 7) = bodies.velocity(i);
    Vec3::Map(row + 10) = bodies.angular_velocity(i);
  }
}

void Batch::restore(std::span<const std::int64_t> worlds,
                    std::span<const WorldState* const> states) {
  std::vector<WorldState> before;
  for (const std::int64_t w : worlds) before.push_back(world(w).state());
  for (std::size_t k = 0; k < worlds.size(); ++k) {
    try {
      world(worlds[k]).restore(*states[k]);
    } catch (...) {
      while (k-- > 0) world(worlds[k]).restore(before[k]);
      throw;
    }
  }
  for (const std::int64_t w : worlds) set_failure(w, {});
}

void Batch::reset(std::span<const std::int64_t> worlds) {
  std::vector<const WorldState*> states;
  for (const std::int64_t w : worlds) states.push_back(&initial_[usize(w)]);
  restore(worlds, states);
}

}  // namespace substep::rigid
