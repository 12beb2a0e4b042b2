// All that a world is, but for its options: a world that is restored from it goes on with the same
// bits.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/rigid/motion/bodies.h"
#include "substep/rigid/motion/body_pair.h"
#include "substep/rigid/shapes/shapes.h"
#include "substep/rigid/solver/contact_constraint.h"
#include "substep/rigid/solver/joint.h"
#include "substep/rigid/world/material_pairs.h"

namespace substep::rigid {

struct WorldState {
  double time = 0;
  std::int64_t steps = 0;
  Bodies bodies;
  std::vector<Fixture> fixtures;
  std::vector<std::int32_t> fixture_body;  // ascending
  std::vector<BodyPair> excluded;
  std::vector<MaterialPair> material_pairs;
  std::vector<Joint> joints;
  // With their impulses, in the order of their fixtures; the contacts of sleeping bodies too.
  std::vector<ContactConstraint> contacts;
  // Of each body, see Islands; Islands::kNoBody of those that are not dynamic.
  std::vector<double> slow_time;
  std::vector<std::int32_t> island;
  std::vector<double> rest_x, rest_q;  // (n, 3), (n, 4): see World::fall_asleep()
  // Where the last step had the bodies: who is elsewhere was moved since, and wakes what it meets.
  std::vector<double> placed_x, placed_q;
};

}  // namespace substep::rigid
