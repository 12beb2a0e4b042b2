// The contacts of a step: the narrow phase over all pairs that may touch.
//
// How far a pair is looked at depends on how far it may approach in the step. What is slow for its
// size meets along the normal that the shapes have now. What is fast is followed to where it will
// meet (time_of_impact.h): normal and points are those of that time, the separation is what the
// motion along the normal takes until then, so that the solver has the impact happen there and then
// whatever the speed, and what merely passes by is not met at all.
//
// Bodies that move along with each other do not approach, until one of them meets something. What
// follows those that are set back is looked for so much farther (setbacks.h).
//
// Contacts are in the order of the fixtures' numbers, and those of a pair that was in contact a
// step before begin with the impulses of then. They depend on poses, velocities and the last
// contacts alone.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/solver/contact_constraint.h"
#include "substep/rigid/solver/round_contacts.h"
#include "substep/rigid/world/fixtures.h"
#include "substep/rigid/world/seams.h"
#include "substep/rigid/world/setbacks.h"

namespace substep::rigid {

class ContactFinder {
 public:
  // motion[b], ways[b]: of body b, in this step. `slots`: BroadPhase::slots(). `last`: contacts in
  // the order of their fixtures, to take impulses from. Unless continuous, fast bodies meet only
  // what is near.
  void find(std::span<const FixturePair> pairs, std::int32_t slots, const Fixtures& fixtures,
            std::span<const Motion> motion, std::span<const Way> ways,
            std::span<const ContactConstraint> last, bool continuous,
            std::vector<ContactConstraint>& contacts, int threads);

  // Puts the contact where its shapes touch with their bodies at these poses, without impulses.
  // Returns whether they do, within its margin; else it stays as it is.
  static bool touch_at(const Fixtures& fixtures, std::span<const Motion> motion, const Pose& body_a,
                       const Pose& body_b, ContactConstraint& contact);

  // Where spheres, capsules and a plane of the contact are, if it has no other shapes.
  static std::optional<RoundPair> round_pair(const Fixtures& fixtures,
                                             std::span<const Motion> motion,
                                             const ContactConstraint& contact);

 private:
  class Search;
  // A pair at a time [part of the step] when it touches.
  struct Touch {
    FixturePair pair;
    double time;
    Manifold manifold;
  };

  void leave_out_seams(const Fixtures& fixtures, std::span<const Way> ways);
  void find_followers(std::span<const FixturePair> pairs, const Fixtures& fixtures,
                      std::span<const Motion> motion, std::span<const Way> ways);

  std::vector<Cache> caches_;                    // of each slot
  std::vector<std::vector<Touch>> touches_;      // of each chunk
  std::vector<Setbacks::Found> found_;           // of each chunk
  std::vector<std::vector<Seams::Edge>> edges_;  // of each chunk
  Seams seams_;
  Setbacks setbacks_;
  std::vector<std::int32_t> followers_;  // pairs
  std::vector<std::size_t> first_;       // contact of each chunk
};

}  // namespace substep::rigid
