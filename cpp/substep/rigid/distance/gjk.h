// The distance of two convex sets by their support functions (Gilbert, Johnson, Keerthi, "A fast
// procedure for computing the distance between complex objects in three-dimensional space", IEEE J.
// Robotics and Automation 4(2), 1988), in the form of van den Bergen ("A fast and robust GJK
// implementation for collision detection of convex objects", JGT 4(2), 1999): the point v of b - a
// closest to 0 is sought in a simplex of at most four points w = y - x, x in a, y in b.
#pragma once

#include "substep/rigid/shapes/convex.h"

namespace substep::rigid {

struct Simplex {
  int count = 0;
  Vec3 w[4], x[4], y[4];
  double weight[4];

  Vec3 closest() const;  // sum weight w
  Vec3 on_a() const;     // sum weight x
};

// b - a, in the frame of a.
struct Difference {
  const Convex &a, &b;
  Pose pose_b;  // in the frame of a

  // The point farthest along d, from its points on a and b.
  Vec3 support(const Vec3& d, Vec3& x, Vec3& y) const {
    x = a.support(-d);
    y = pose_b.to_world(b.support(pose_b.rotation.transpose() * d));
    return y - x;
  }
  // s(n) of the cores.
  double separation(const Vec3& n) const {
    Vec3 x, y;
    return n.dot(support(-n, x, y));
  }
  double scale() const { return a.extent + b.extent + pose_b.position.norm(); }
};

// Whether what the cores turn to each other may be curved.
inline bool is_curved(const Difference& d) {
  const auto curved = [](Convex::Core core) {
    return core == Convex::Core::cylinder || core == Convex::Core::other;
  };
  return curved(d.a.core) || curved(d.b.core);
}

// The distance of the cores, or no more than a proof that it is above `enough`. Overlap: 0, and the
// simplex holds the origin or comes within 1e-10 of the scale of it.
struct Distance {
  double value;
  Vec3 normal;  // from a to b; of length 1 where value > 0
  Simplex simplex;
};
Distance distance(const Difference& difference, const Vec3& start, double enough);

}  // namespace substep::rigid
