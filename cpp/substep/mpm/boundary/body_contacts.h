// Nodes in an obstacle that yields: what they and the body behind it do to each other, found
// together.
//
// The body has velocity V (of its centre of mass, and turning about it) and mobility W. A node of
// mass m and velocity v at r from the centre of mass meets a surface of velocity u = G V, G = [1,
// -[r]_x], and takes its condition (boundary.h): an impulse j(u), of which the body takes the
// opposite. So the body ends with V + W y where
//   F(y) = y + sum_i G_i^T j_i(G_i (V + W y)) = 0,
// six equations, however many nodes there are and however light the body is. Newton's method:
//   (1 + H W) dy = -F,  H = sum_i G_i^T (dj_i/du) G_i.
// The most that friction takes off the velocity along the surface, mu times what the condition adds
// to v.n, counts as given in each iteration. Then j_i is the gradient of a convex function psi_i of
// u, and W F that of
//   phi(y) = y.W y / 2 + sum_i psi_i,
// so that dy leads down, and is halved where phi does not fall. Sticky nodes take one iteration.
#pragma once

#include <cstdint>
#include <span>

#include "substep/geometry/collider.h"
#include "substep/mpm/boundary/boundary.h"

namespace substep::mpm {

struct BodyContact {
  std::size_t collider;
  std::int64_t node;  // place among all nodes
  double mass;        // a node in several such obstacles gives each an equal part
  geometry::Vec3 arm, v, n;
  Boundary boundary;
  double friction;
  double bound = 0;                                 // the most that friction takes off v [m/s]
  geometry::Vec3 impulse = geometry::Vec3::Zero();  // on the node, set by meet() [N s]
};

// The contacts of one body, in a fixed order.
void meet(const geometry::Vec6& velocity, const geometry::Mat6& mobility,
          std::span<BodyContact> contacts);

}  // namespace substep::mpm
