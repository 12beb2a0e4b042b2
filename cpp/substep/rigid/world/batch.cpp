#include "substep/rigid/world/batch.h"

#include <algorithm>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {
constexpr std::int64_t kBlock = 16;  // steps of a world in a row: what keeping its state costs less
}  // namespace

Batch::Batch(std::span<const World* const> worlds) : failures_(worlds.size()) {
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
  for (std::size_t w = 0; steps.hold_forces && w < worlds_.size(); ++w) {
    force_[w] = worlds_[w].bodies().force;
    torque_[w] = worlds_[w].bodies().torque;
  }
  for (std::int64_t begin = 0; begin < steps.count; begin += kBlock) {
    run_block(steps, begin, std::min(begin + kBlock, steps.count));
  }
}

// Steps from `begin` to `end`, counted in this call.
void Batch::run_block(const Steps& steps, std::int64_t begin, std::int64_t end) {
  kept_.resize(worlds_.size());
  reached_.assign(worlds_.size(), begin);
  const std::vector<std::string> failed_before = failures_;
  const auto each = [&](auto&& task) { parallel_chunks(size(), task, threads); };
  each([&](std::int64_t w) { kept_[usize(w)] = worlds_[usize(w)].state(); });
  try {
    each([&](std::int64_t w) { run(w, steps, begin, end); });
  } catch (...) {
    failures_ = failed_before;
    return_to(begin, steps, begin);
    throw;
  }
  std::int64_t goal = end, first = -1;
  for (std::int64_t w = 0; w < size() && !mask; ++w) {
    if (reached_[usize(w)] >= goal) continue;
    goal = reached_[usize(w)];
    first = w;
  }
  for (std::int64_t s = begin; s < goal; ++s) time += steps.dt;
  if (first < 0) return;
  const std::string reason = failures_[usize(first)];
  failures_ = failed_before;
  return_to(goal, steps, begin);
  const std::string text = "world " + std::to_string(first) + ": " + reason;
  if (reason.starts_with("joint")) throw SolverError(text, world(first).time, first, goal);
  throw NonFiniteError(text, world(first).time, first, goal);
}

void Batch::run(std::int64_t w, const Steps& steps, std::int64_t begin, std::int64_t end) {
  World& world = worlds_[usize(w)];
  if (!failures_[usize(w)].empty()) {
    reached_[usize(w)] = end;
    return;
  }
  for (std::int64_t s = begin; s < end; ++s) {
    if (steps.hold_forces) {
      world.bodies().force = force_[usize(w)];
      world.bodies().torque = torque_[usize(w)];
    }
    try {
      world.step(steps.dt);
    } catch (const SolverError& error) {
      failures_[usize(w)] = error.what();
      return;
    }
    reached_[usize(w)] = s + 1;
    if ((s + 1) % steps.frames.every == 0)
      record(w, (s + 1) / steps.frames.every - 1, steps.frames);
  }
}

// Worlds that went further are as they were after step `goal`.
void Batch::return_to(std::int64_t goal, const Steps& steps, std::int64_t begin) {
  const DeferInterrupts whole;
  parallel_chunks(
      size(),
      [&](std::int64_t w) {
        if (reached_[usize(w)] <= goal) return;
        worlds_[usize(w)].restore(kept_[usize(w)]);
        run(w, steps, begin, goal);
      },
      threads);
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
  for (const std::int64_t w : worlds) failures_[usize(w)].clear();
}

void Batch::reset(std::span<const std::int64_t> worlds) {
  std::vector<const WorldState*> states;
  for (const std::int64_t w : worlds) states.push_back(&initial_[usize(w)]);
  restore(worlds, states);
}

}  // namespace substep::rigid
