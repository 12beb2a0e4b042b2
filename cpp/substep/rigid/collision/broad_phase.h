// Broad phase: which fixtures come near each other.
//
// Every fixture has a fat box, which holds its bounds and some room to move, and is made anew only
// when the bounds leave it. Two fixtures are a pair while their fat boxes overlap (a plane: while
// the box reaches its half space), they are of different bodies of which one is dynamic, groups and
// masks agree and the bodies are not excluded: so a step costs one comparison for a fixture that
// stays in its box, and one query of the tree for one that does not. A pair is new if the boxes of
// the last step did not overlap, so nothing need be looked up.
//
// The pairs are sorted by the numbers of their fixtures: their order does not depend on threads, on
// the history, nor on the shape of the trees. Which pairs that do not touch are among them does
// depend on the history of the fat boxes, so what is computed must not depend on these pairs.
//
// Measured on one thread of a Zen 5 core for piles of spheres, against a sweep over boxes that stay
// sorted along an axis (8 compared at once, every step anew, pairs neither sorted nor persistent):
// 1000 that settle take 32 us a step against 30. While 10,000 move at 0.3 m/s it is 2.2 ms against
// 1.0, while they fall 4.6 against 1.0; but the sweep costs the same at rest, grows with n^(5/3)
// and has its pairs still to sort. At rest a step is 270 instructions a fixture, for 1000 as for
// 30,000, and also where one of them is as large as the pile (bench/cpp/rigid_broad_phase.cpp).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/collision/aabb_tree.h"
#include "substep/rigid/motion/bodies.h"
#include "substep/rigid/motion/body_pair.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

struct FixturePair {
  std::int32_t a, b;  // a < b
  // Where the caller keeps its data of the pair: stays the same as long as the pair does; below
  // slots(). That of a pair that ended is given to another from the next update on.
  std::int32_t slot;
};

class BroadPhase {
 public:
  struct Proxy {
    std::int32_t body = 0;
    Motion motion = Motion::kDynamic;
    std::uint32_t group = 1, mask = 0xffffffff;
  };

  // Fixtures have numbers of the caller's choice, small ones. They take part from the next update
  // on. A fixture is awake at first, unless static; one that is added under the number of one that
  // was removed is another.
  void add(std::int32_t fixture, const Proxy& proxy, const Bounds& bounds);
  void add_plane(std::int32_t fixture, const Proxy& proxy, const Vec3& normal, double offset);
  void remove(std::int32_t fixture);
  // So that adding so many fixtures with numbers below `end` does not take memory.
  void make_room(std::int32_t end, std::int32_t count);

  // A pair is among pairs() while one of its fixtures is awake; others cost nothing.
  void set_awake(std::int32_t fixture, bool awake);

  // Bodies (e.g. those of a joint) whose fixtures shall not be pairs; replaces the last ones.
  void exclude(std::vector<BodyPair> pairs);

  // fixtures[f] and bodies[b]: the new numbers of fixture f and body b, ascending, -1 for removed
  // ones (see Bodies::remove). Pairs of removed fixtures are gone at once and their slots free, the
  // others keep theirs; begun() and ended() are empty. InputError, and nothing changed: a fixture
  // that was not removed has no number, or numbers do not ascend.
  void renumber(std::span<const std::int32_t> fixtures, std::span<const std::int32_t> bodies);

  // Takes the bounds of the fixtures that are listed; bounds[f] is that of fixture f. Pairs must be
  // complete for the bounds, so make them larger by half the distance at which contacts begin and,
  // for continuous collision, by the way of the step. Throws NonFiniteError (index: the fixture),
  // and changes nothing, if one is not finite.
  void update(std::span<const std::int32_t> moving, std::span<const Bounds> bounds,
              int threads = 0);

  // Sorted, of the last update. A pair that ended and began in one update is in both.
  std::span<const FixturePair> pairs() const { return awake_; }
  std::span<const FixturePair> sleeping_pairs() const { return asleep_; }
  std::span<const FixturePair> begun() const { return begun_; }
  std::span<const FixturePair> ended() const { return ended_; }
  std::int32_t slots() const { return slots_; }

  // The fixtures whose fat boxes (half spaces) overlap with the bounds, in ascending order.
  std::vector<std::int32_t> overlapping(const Bounds& bounds) const;

  // Calls visit(fixture) for all that a box of these half lengths may meet on its way, in no order
  // to rely on; visit returns the length that the way has from now on.
  template <class Visit>
  void cast(const Vec3& origin, const Vec3& direction, double length, const Vec3& half_lengths,
            Visit&& visit) const {
    const auto shortened = [&](std::int32_t fixture) { return length = visit(fixture); };
    for (const std::int32_t plane : planes_) shortened(plane);
    for (const AabbTree* tree : {&ground_, &movable_}) {
      tree->cast(TreeRay(origin, direction, length, half_lengths), shortened);
    }
  }

  // Whether two fixtures may be a pair, wherever they are.
  bool may_touch(std::int32_t a, std::int32_t b) const;

  std::size_t bytes() const;

 private:
  enum class Kind : std::uint8_t { kNone, kBox, kPlane };
  enum Change : std::uint8_t { kSame = 0, kMoved = 1, kReplaced = 2 };
  struct Entry {
    Proxy proxy;
    Kind kind = Kind::kNone;
    bool awake = false;
    std::int64_t step = 0;       // in which the fat box was made
    Vec3 centre = Vec3::Zero();  // of the bounds then; of a plane the normal
    double offset = 0;           // of a plane
  };

  Entry& enter(std::int32_t fixture, const Proxy& proxy, Kind kind);
  void replace(std::int32_t fixture);
  AabbTree& tree(std::int32_t fixture);
  bool near(std::int32_t a, std::int32_t b, const std::vector<TreeBox>& boxes) const;

  void find_left(std::span<const std::int32_t> moving, std::span<const Bounds> bounds, int threads);
  void move_boxes(std::span<const Bounds> bounds);
  void find_new(std::int32_t fixture, std::vector<FixturePair>& found) const;
  void find_begun(int threads);
  void apply(std::vector<FixturePair>& pairs, bool awake);
  void sort_by_sleep();
  void recycle(const std::vector<FixturePair>& pairs);

  AabbTree ground_, movable_;  // static fixtures; all others
  std::vector<std::int32_t> planes_;
  std::vector<Entry> entries_;
  std::vector<TreeBox> box_, old_box_;   // fat; of the last update where it changed since
  std::vector<std::uint8_t> change_;     // since the last update
  std::vector<std::int32_t> changed_;    // fixtures with any
  std::vector<std::uint64_t> excluded_;  // sorted keys of body pairs
  std::vector<FixturePair> awake_, asleep_, begun_, ended_, merged_;
  std::vector<std::vector<std::int32_t>> left_;  // of each chunk
  std::vector<std::vector<FixturePair>> found_;  // of each chunk
  std::vector<std::int32_t> free_slots_;
  std::int32_t slots_ = 0;
  std::int64_t step_ = 0;
  bool sleep_changed_ = false;
};

}  // namespace substep::rigid
