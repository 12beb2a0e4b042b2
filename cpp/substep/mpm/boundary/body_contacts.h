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

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

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
  geometry::Vec3 impulse = geometry::Vec3::Zero();  // on the node [N s]
};

// The obstacles of a step, where some yield.
class Bodies {
 public:
  // With the velocities that bodies have before anything pushes; none where none yields.
  void begin(const std::vector<geometry::Collider>& colliders, double dt);
  void end() noexcept;
  bool any() const { return !moving_.empty(); }
  // Since meet(): with the velocities of the step, and what nodes give as their exchange().
  const std::vector<geometry::Collider>& moving() const { return moving_; }
  // Of the material near to the body of each [kg].
  const std::vector<double>& masses() const { return masses_; }

  // Finds the impulses of all contacts. near: of the material near to each collider.
  void meet(std::span<BodyContact* const> contacts, std::span<const double> near, int threads);

 private:
  std::vector<geometry::Collider> moving_;
  std::vector<double> masses_;
};

// As geometry::push_bodies, for what one collider was given, and without memory.
void push_body(std::span<geometry::Collider> colliders, std::size_t pushed,
               const geometry::Exchange& exchange) noexcept;

}  // namespace substep::mpm
