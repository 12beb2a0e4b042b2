// By how much bodies are behind their ways at the end of a step [m], their setbacks, and what meets
// because of them.
//
// Two that meet with w of their way along the normal left, and the restitution e, are set back by
// (1 + e) w. One that is set back by s and touches another at a gap stops it, or throws it back,
// which is set back by (1 + e) (n . s - gap) then, and by no more than n . s. Two that are near and
// would not touch on their ways may do so when one is set back, and touch then as the others do.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "substep/core/incidence.h"
#include "substep/core/usize.h"
#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/motion/bodies.h"
#include "substep/rigid/world/fixtures.h"

namespace substep::rigid {

class Setbacks {
 public:
  // Of a body that moves freely.
  struct Stop {
    std::int32_t body;
    Vec3 back;
  };
  // Of two that touch, and both move freely.
  struct Push {
    std::int32_t a, b;  // bodies
    Vec3 normal;
    double gap, bounce;  // bounce: 1 + e
  };
  // Of two that are near, and both move freely.
  struct Near {
    std::int32_t a, b, pair;
    std::int32_t push = -1;  // once they touch
    double least;            // they stay apart unless their setbacks differ by more
    double looked = 0;       // setbacks of both, squared, when they were looked at
  };
  // Of a chunk of pairs.
  struct Found {
    std::vector<Stop> stops;
    std::vector<Push> pushes;
    std::vector<Near> near;
    void clear() { stops.clear(), pushes.clear(), near.clear(); }
  };
  // How far two that are near go, each along its way and back, and by how much a gap closes.
  struct Approach {
    double length;
    Vec3 closing;
  };

  // meet(pair, approach): the push of the two, if they touch then. It is asked for all that are
  // near a body that is set back, until none is by more than it was.
  template <class Meet>
  void spread(std::span<const Found> found, std::span<const FixturePair> pairs,
              const Fixtures& fixtures, std::span<const Way> ways, const Meet& meet) {
    if (!begin(found, fixtures, ways)) return;
    const auto touching = static_cast<std::int32_t>(pushes_.size());
    for (std::size_t k = 0; k < queue_.size(); ++k) {
      bodies_[usize(queue_[k])].waits = false;
      for (const std::int32_t item : of_body_.of(queue_[k])) {
        std::int32_t push = item;
        if (item >= touching) {
          Near& near = near_[usize(item - touching)];
          if (near.push < 0 && may_meet(near, pairs[usize(near.pair)], fixtures, ways))
            join(near, meet(near.pair, approach(near, ways)));
          push = near.push;
        }
        if (push >= 0) pass_on(pushes_[usize(push)]);
      }
    }
  }

 private:
  // Rounding must not make one larger and larger that goes round a body between two others.
  static constexpr double kMore = 1.01;
  struct Body {
    Vec3 back = Vec3::Zero();
    bool waits = false;  // in the queue
  };

  bool begin(std::span<const Found> found, const Fixtures& fixtures, std::span<const Way> ways);
  void set(std::int32_t body, const Vec3& back);
  void pass_on(const Push& push);
  void join(Near& near, const std::optional<Push>& push);
  Approach approach(const Near& near, std::span<const Way> ways) const;
  bool may_meet(Near& near, const FixturePair& pair, const Fixtures& fixtures,
                std::span<const Way> ways);
  const Bounds& box(std::int32_t fixture, const Fixtures& fixtures);

  std::vector<Body> bodies_;
  std::vector<std::int32_t> queue_;  // bodies
  std::vector<Push> pushes_;
  std::vector<Near> near_;
  Incidence of_body_;                  // pushes, then near ones
  std::vector<Bounds> boxes_;          // of fixtures, where they are
  std::vector<std::uint8_t> has_box_;  // of each fixture
};

}  // namespace substep::rigid
