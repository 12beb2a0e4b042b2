// A world of rigid bodies: what a step does, and what holds from step to step.
//
// Bodies have numbers in the order in which they were added, and so have their fixtures; what is
// removed makes those behind it move up. State of a body: bodies.h. Contact, restitution, friction:
// contact_constraint.h, contact_solver.h; sleep: islands.h; fast bodies: contact_finder.h.
//
// Surfaces of a pair: friction sqrt(f_a f_b), restitution, rolling and spinning levers the greater
// of both.
//
// What a step computes depends on what state() holds, on nothing else: not on pairs that come near
// without touching, nor on how the broad phase came to its boxes, nor on threads.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/broad_phase.h"
#include "substep/rigid/contact_finder.h"
#include "substep/rigid/contact_solver.h"
#include "substep/rigid/fixtures.h"
#include "substep/rigid/islands.h"
#include "substep/rigid/queries.h"

namespace substep::rigid {

struct WorldOptions {
  Vec3 gravity{0, 0, -9.81};  // [m/s^2]
  ContactOptions contact;
  double contact_margin = 0.02;  // distance at which contacts begin, or a tenth of the inner radius
                                 // of smaller bodies [m]
  Islands::Sleep sleep;
  bool sleeping = true;
  bool continuous = true;  // fast bodies never pass through others
};

// All that a world is, but for its options: restored into any world, it goes on with the same bits.
struct WorldState {
  double time = 0;
  std::int64_t steps = 0;
  Bodies bodies;
  std::vector<Fixture> fixtures;
  std::vector<std::int32_t> fixture_body;  // ascending
  std::vector<BodyPair> excluded;
  std::vector<ContactConstraint> contacts;  // with their impulses, in the order of the fixtures
  std::vector<double> slow_time;            // see Islands
  std::vector<std::int32_t> island;
};

class World {
 public:
  // InputError: an option is out of range.
  explicit World(const WorldOptions& options = {});

  // The number of the new body. InputError: something is out of range (Bodies::add,
  // check_fixtures); nothing changed then. A body may have no fixture: it touches nothing.
  std::int32_t add(const BodyState& body, std::span<const Fixture> fixtures);
  // InputError: no such body; nothing changed then.
  void remove(std::span<const std::int64_t> bodies);
  // Bodies that go through each other.
  void exclude(std::int32_t a, std::int32_t b);

  // By dt [s]. What fails changes nothing: InputError for dt; NonFiniteError names the body;
  // MemoryError; an interrupt.
  void step(double dt);

  // Rows may be written between steps. A body that is asleep wakes where its pose or momentum is
  // written or a force acts on it.
  Bodies& bodies() { return bodies_; }
  const Bodies& bodies() const { return bodies_; }
  const Fixtures& fixtures() const { return fixtures_; }

  // Of the last step, in the order of the fixtures: those of bodies that were awake.
  std::span<const ContactConstraint> contacts() const { return contacts_; }
  Scene scene() const;  // valid while the world lives, where the bodies are now

  WorldState state() const;
  // InputError: the parts do not belong together; nothing changed then.
  void restore(const WorldState& state);

  WorldOptions options;
  double time = 0;         // [s]
  std::int64_t steps = 0;  // done
  int threads = 0;         // 0: num_threads()

 private:
  void add_to_broad_phase(std::int64_t body);
  void place(double dt);

  Bodies bodies_;
  Fixtures fixtures_;
  BroadPhase broad_phase_;
  ContactFinder finder_;
  ContactSolver solver_;
  std::vector<BodyPair> excluded_;
  std::vector<ContactConstraint> contacts_, last_contacts_;
  std::vector<Way> ways_;
  std::vector<std::int32_t> moving_;  // fixtures
};

}  // namespace substep::rigid
