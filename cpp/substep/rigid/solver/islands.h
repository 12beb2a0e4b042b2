// Islands: bodies that touching contacts and joints connect, and their sleep.
//
// An island falls asleep as a whole, when each of its bodies has been slower than a threshold for
// some time, and wakes as a whole; bodies that do not move (static, kinematic ones) connect
// nothing. It need be known which islands there are only when a body is ready to sleep, so nothing
// is kept from step to step but the time that each body has been slow and, of those asleep, with
// whom: that is the state to save.
//
// When to wake(): what changes the motion of a sleeping body (a force, an impulse, a pose or a
// velocity that is set), a contact that begins with an awake or a moving kinematic body, a joint
// that is made or destroyed, a body it touches that is removed or, kinematic, begins to move.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/motion/body_pair.h"

namespace substep::rigid {

// label[i]: the smallest number of a body that is connected with body i, i itself if alone. By
// union and find with path halving (Tarjan, van Leeuwen 1984); the smaller root always stays, so
// the order of the constraints does not matter.
void label_islands(std::span<const BodyPair> constraints, std::span<std::int32_t> label);

class Islands {
 public:
  struct Sleep {
    double speed = 0.05;  // [m/s], below which a body is slow
    double time = 0.5;    // [s] that all of an island must have been slow
  };

  // A dynamic body, by its number: awake. Only these can sleep.
  void add(std::int32_t body);
  // So that adding so many, below `end`, does not take memory.
  void make_room(std::int32_t end, std::int32_t count);
  // Wakes its island first.
  void remove(std::int32_t body);

  // bodies[i]: the new number of body i, ascending, -1 for removed ones (see Bodies::remove).
  // slept() and woken() are then empty.
  void renumber(std::span<const std::int32_t> bodies);

  // After a step of dt [s]. speed [m/s] of every body number (of its fastest point, say): infinity
  // keeps the island awake, for one that touches a moving kinematic body. constraints: joints and
  // contacts that touch, in any order; those between sleeping bodies may be left out.
  // slept(): who fell asleep by this; their velocities are the caller's to set to 0.
  void update(double dt, const Sleep& sleep, std::span<const double> speed,
              std::span<const BodyPair> constraints);

  // Wakes the island of the body; woken() collects who woke since the last update. Nothing happens
  // if it is awake, but that its time begins anew.
  void wake(std::int32_t body);

  bool asleep(std::int32_t body) const { return island_[usize(body)] >= 0; }
  std::span<const std::int32_t> slept() const { return slept_; }
  std::span<const std::int32_t> woken() const { return woken_; }
  // Dynamic bodies that are awake, in ascending order.
  std::span<const std::int32_t> awake() const { return awake_; }

  // The state: the time [s] that each body has been slow, and of a sleeping body the smallest
  // number of its island; kAwake or kNoBody else.
  static constexpr std::int32_t kAwake = -1, kNoBody = -2;
  std::span<const double> slow_time() const { return slow_time_; }
  std::span<const std::int32_t> island() const { return island_; }
  // Throws InputError if an island is not named by the smallest of its bodies.
  void restore(std::span<const double> slow_time, std::span<const std::int32_t> island);

 private:
  void gather_awake();

  std::vector<double> slow_time_;
  std::vector<std::int32_t> island_;
  std::vector<std::int32_t> next_;  // of the island, in a circle
  std::vector<std::int32_t> awake_, slept_, woken_;
  std::vector<BodyPair> ready_pairs_;
  std::vector<std::int32_t> label_, last_;
  std::vector<std::uint8_t> restless_;  // of the label of an island
};

}  // namespace substep::rigid
