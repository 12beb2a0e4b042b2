// Many worlds that know nothing of each other, stepped in one call.
//
// Threads take whole worlds; a world steps serially, a block of steps in a row while it lies in the
// cache. So each has the bits of the same world alone, for any number of threads.
//
// Before a block the state of all worlds is kept. Where one fails, those that went further go back
// to it and step again up to the last step that all have done, so the batch is at one step; where
// anything else ends the block (an interrupt, no memory), all are where it began.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

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

class Batch {
 public:
  // Copies; their own threads are of no effect. A batch may be empty.
  explicit Batch(std::span<const World* const> worlds);

  std::int64_t size() const { return static_cast<std::int64_t>(worlds_.size()); }
  World& world(std::int64_t w) { return worlds_[usize(w)]; }
  const World& world(std::int64_t w) const { return worlds_[usize(w)]; }
  std::int64_t most_bodies() const;  // of a world

  struct Steps {
    double dt = 0;  // [s]
    std::int64_t count = 1;
    bool hold_forces = false;  // in all steps, else in the first only
    Frames frames;
  };
  // Steps all worlds that have not failed. NonFiniteError (index: the world, step: of this call)
  // says which world failed first and why; the batch is then after the last step that all have
  // done. With `mask`, a world that fails stays after its own last good step, and the others go on.
  void step(const Steps& steps);

  // Why a world takes no part any more, empty if it does.
  const std::string& failure(std::int64_t w) const { return failures_[usize(w)]; }
  void set_failure(std::int64_t w, std::string reason) { failures_[usize(w)] = std::move(reason); }

  // From now on these states; a world that had failed takes part again. InputError, and nothing
  // changed: a state is none.
  void restore(std::span<const std::int64_t> worlds, std::span<const WorldState* const> states);
  // To the state that they had when keep_initial() was called, or at first.
  void reset(std::span<const std::int64_t> worlds);
  const WorldState& initial(std::int64_t w) const { return initial_[usize(w)]; }
  void keep_initial();

  bool mask = false;
  double time = 0;  // [s] that the batch was stepped; a world's own changes with its state
  int threads = 0;  // 0: num_threads()

 private:
  void keep();
  void run_block(const Steps& steps, std::int64_t begin, std::int64_t end);
  void run(std::int64_t w, const Steps& steps, std::int64_t begin, std::int64_t end);
  void return_to(std::int64_t goal, const Steps& steps, std::int64_t begin);
  void record(std::int64_t w, std::int64_t step, const Frames& frames) const;

  std::vector<World> worlds_;
  std::vector<std::string> failures_;
  std::vector<WorldState> initial_;
  std::vector<WorldState> kept_;                     // at the start of the block
  std::vector<std::int64_t> reached_;                // steps of this call that each world has done
  std::vector<std::vector<double>> force_, torque_;  // that are held
};

}  // namespace substep::rigid
