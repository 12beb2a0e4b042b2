// When moving shapes come so near to each other that they touch: continuous collision of bodies
// that are fast for their size, and shapes that are cast along a way.
//
// Conservative advancement (Mirtich, "Timewarp rigid body simulation", SIGGRAPH 2000) along the
// normal n at the time t, from a to b. With displacements x and rotation vectors w over the step,
// and r the largest distance of a's (of b's) core from the centre it turns about, no point goes
// along n faster than
//   mu = (x_a - x_b) . n + |n x w_a| r_a + |n x w_b| r_b
// per step, so that the planes across n, which are d apart, stay apart until t + d / mu: in this
// time nothing meets, and if mu <= 0 nothing meets at all. Where nothing turns it is exact after as
// many advances as faces, edges or corners become the nearest.
#pragma once

#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

// How a shape goes on during a step, 0 <= t <= 1: the body's centre along a line, turning steadily.
struct Course {
  Pose body;                   // at t = 0
  Vec3 travel = Vec3::Zero();  // of the centre [m]
  Vec3 turn = Vec3::Zero();    // rotation vector [rad]
  Pose local;                  // of the shape in the frame of the body

  Pose at(double t) const;
};

struct Impact {
  enum class State {
    kApart,     // all the time
    kTouching,  // from `time` on, apart before
    kOverlap    // already at t = 0
  };
  State state = State::kApart;
  double time = 1;
  Vec3 normal = Vec3::Zero();  // from a to b at that time; 0 unless kTouching
};

// The first time at which the shapes, until then further apart, are at a distance between `target`
// (>= 0) and `target + tolerance` (tolerance > 0) and still approach. Shapes that begin nearer than
// that touch at once, unless they part. Of a mesh, which must not move, each triangle in whose
// front the centre of the other begins. After very many advances (fast rotation close by) the time
// that was reached is taken for that of the impact: nothing ever passes. InputError for two of
// planes and meshes, and for a plane or mesh that moves.
Impact time_of_impact(const Shape& a, const Course& course_a, const Shape& b,
                      const Course& course_b, double target, double tolerance);

}  // namespace substep::rigid
