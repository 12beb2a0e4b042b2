// Many worlds of rigid bodies that know nothing of each other, stepped in one call.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "substep/core/many_worlds.h"
#include "substep/core/usize.h"
#include "substep/rigid/world/world.h"

namespace substep::rigid {

// What a world has recorded: after each `every`-th step a frame, whose rows are the bodies'
// position and rotation (w, x, y, z), 7 columns, and in 13 columns velocity and angular velocity
// too. The rows of worlds with fewer bodies, and frames that a failed world did not reach, stay
// untouched.
struct Frames {
  std::span<double> values;  // (worlds, frames, bodies, columns)
  std::int64_t frames = 0, bodies = 0, columns = 7, every = 1;
};

class Batch : public ManyWorlds {
 public:
  // Copies; their own threads are of no effect. A batch may be empty.
  explicit Batch(std::span<const World* const> worlds);

  World& world(std::int64_t w) { return worlds_[usize(w)]; }
  const World& world(std::int64_t w) const { return worlds_[usize(w)]; }
  std::int64_t most_bodies() const;  // of a world

  struct Steps {
    double dt = 0;  // [s]
    std::int64_t count = 1;
    bool hold_forces = false;  // in all steps, else in the first only
    Frames frames;
  };
  void step(const Steps& steps);

  // From now on these states; a world that had failed takes part again. InputError, and nothing
  // changed: a state is none.
  void restore(std::span<const std::int64_t> worlds, std::span<const WorldState* const> states);
  // To the state that they had when keep_initial() was called, or at first.
  void reset(std::span<const std::int64_t> worlds);
  const WorldState& initial(std::int64_t w) const { return initial_[usize(w)]; }
  void keep_initial();

  double time = 0;  // [s] that the batch was stepped; a world's own changes with its state

 private:
  void take_step(std::int64_t w, std::int64_t s) override;
  void keep_world(std::int64_t w) override { kept_[usize(w)] = world(w).state(); }
  void put_back(std::int64_t w) override { world(w).restore(kept_[usize(w)]); }
  double time_of(std::int64_t w) const override { return world(w).time; }
  void done(std::int64_t steps) override;
  void record(std::int64_t w, std::int64_t step, const Frames& frames) const;

  std::vector<World> worlds_;
  std::vector<WorldState> initial_;
  std::vector<WorldState> kept_;                     // at the start of a block
  Steps steps_;                                      // of the call
  std::vector<std::vector<double>> force_, torque_;  // that are held
};

}  // namespace substep::rigid
