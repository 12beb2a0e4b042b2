// Simulations of any one method as worlds of a batch.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "substep/core/many_worlds.h"
#include "substep/core/simulation.h"
#include "substep/core/usize.h"

namespace substep {

class SimulationBatch final : public ManyWorlds {
 public:
  // They stay the owner's.
  explicit SimulationBatch(std::vector<Simulation*> worlds)
      : ManyWorlds(worlds.size()), worlds_(std::move(worlds)) {}

  // `count` steps of each world, of its own size [s]; 0: none, NaN: step_by_limit(). The times of
  // the worlds are then `times` [s], but for those that are NaN.
  void step(std::span<const double> sizes, std::span<const double> times, std::int64_t count);
  // Simulation::advance of each world to its own end [s], as one step: where a world fails, all are
  // where they began; with `mask` that world is after its last good step.
  void advance(std::span<const double> ends);
  // Simulation::advance_once of each world that is not at its end.
  void advance_once(std::span<const double> ends, bool first);

  const Simulation& world(std::int64_t w) const { return *worlds_[usize(w)]; }
  double time() const;  // of the world that is last, of those that go on if any does [s]

 private:
  enum class Call { kStep, kAdvance, kAdvanceOnce };

  void take_step(std::int64_t w, std::int64_t s) override;
  void keep_world(std::int64_t w) override { worlds_[usize(w)]->keep(); }
  void put_back(std::int64_t w) override { worlds_[usize(w)]->rewind(); }
  double time_of(std::int64_t w) const override { return worlds_[usize(w)]->time(); }
  void advance_whole(Simulation& world, double end) const;

  std::vector<Simulation*> worlds_;
  // Of the call.
  Call call_ = Call::kStep;
  std::span<const double> sizes_, times_;
  bool first_ = true;
};

}  // namespace substep
