// Many worlds that know nothing of each other, stepped in one call.
//
// Threads take whole worlds; a world steps serially, a block of steps in a row while it lies in the
// cache. So each has the bits of the same world alone, for any number of threads.
//
// Before a block each world is kept. Where one fails, those that went further go back and step
// again up to the last step that all have done, so all are at one step; where anything else ends
// the block (an interrupt, no memory), all are where it began.
#pragma once

#include <cstdint>
#include <exception>
#include <string>
#include <vector>

#include "substep/core/usize.h"

namespace substep {

class ManyWorlds {
 public:
  virtual ~ManyWorlds() = default;

  std::int64_t size() const { return static_cast<std::int64_t>(failures_.size()); }
  // Why a world takes no part any more, empty if it does.
  const std::string& failure(std::int64_t w) const { return failures_[usize(w)]; }
  void set_failure(std::int64_t w, std::string reason) { failures_[usize(w)] = std::move(reason); }

  // A world that fails stays alone after its own last good step, and the others go on.
  bool mask = false;
  int threads = 0;  // 0: num_threads()

 protected:
  explicit ManyWorlds(std::size_t count) : failures_(count) {}
  ManyWorlds(const ManyWorlds&) = default;
  ManyWorlds& operator=(const ManyWorlds&) = default;

  // Takes so many steps in all worlds that have not failed. SolverError, of the kind of the failure
  // (index: the world, step: of this call), says which world failed first and why, unless `mask`.
  void run(std::int64_t count);

  // Step `s` of the call in world `w`. SolverError: it failed, and is as it was before.
  virtual void take_step(std::int64_t w, std::int64_t s) = 0;
  // Keeps the state of a world, and goes back to it, once.
  virtual void keep_world(std::int64_t w) = 0;
  virtual void put_back(std::int64_t w) = 0;
  virtual double time_of(std::int64_t w) const = 0;  // [s]
  // All that have not failed have done so many steps more.
  virtual void done(std::int64_t /*steps*/) {}

 private:
  void run_block(std::int64_t begin, std::int64_t end);
  void run_world(std::int64_t w, std::int64_t begin, std::int64_t end);
  void return_to(std::int64_t goal, std::int64_t begin);
  [[noreturn]] void raise(std::int64_t w, std::int64_t step) const;

  std::vector<std::string> failures_;
  std::vector<std::exception_ptr> errors_;  // of the block
  std::vector<std::int64_t> reached_;       // steps of this call that each world has done
};

}  // namespace substep
