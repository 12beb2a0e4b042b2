// Where two shapes touch: up to four points with one normal.
#pragma once

#include <cstdint>
#include <utility>

#include "substep/rigid/shapes/pose.h"

namespace substep::rigid {

struct ContactPoint {
  Vec3 on_a, on_b;        // on the surfaces, in the world: on_b - on_a = separation * normal
  double separation;      // [m], below 0 where they penetrate
  std::uint32_t feature;  // names the corners, edges and faces that meet, as long as they do
};

struct Manifold {
  Vec3 normal = Vec3::Zero();  // of length 1, from a to b
  int count = 0;
  ContactPoint points[4];

  void add(const ContactPoint& point) { points[count++] = point; }
  // The same contact for b and a.
  void flip() {
    normal = -normal;
    for (int k = 0; k < count; ++k) std::swap(points[k].on_a, points[k].on_b);
  }
};

// What the last call learnt of a pair. It saves time and never changes a result, so that it need
// not be saved with a state: an axis that still separates ends the search at once.
struct Cache {
  Vec3 axis = Vec3::Zero();  // in the frame of a; 0: none
};

}  // namespace substep::rigid
