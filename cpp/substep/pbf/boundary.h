// What obstacles do to a fluid: a share of the density near them, and no way through.
//
// An obstacle is taken as filled with the fluid at rest. For a plane wall at distance s that adds
//   b(s) = integral of W over the half space beyond the wall,   grad b = b'(s) n,
// which a table holds; a curved wall counts as the plane at its nearest point, and a hollow box as
// its six planes (so in a corner what lies beyond two of them is counted twice).
#pragma once

#include <span>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/pbf/density.h"

namespace substep::pbf {

using geometry::Vec3;

template <class Real>
class Boundary {
 public:
  Boundary(std::vector<geometry::Collider> obstacles, const DensityConstraint<Real>& density,
           const Vec3& origin);

  // Before the sweeps of a step, with the predicted positions: who may come near an obstacle.
  void find_near(std::span<const Point<Real>> x, int threads);
  // Rows (grad b_i, b_i) at x, one for each particle, 0 away from all obstacles.
  std::span<const Point<Real>> contributions(std::span<const Point<Real>> x, int threads);
  // Moves particles out of the obstacles, after each sweep.
  void push_out(std::span<Point<Real>> x, int threads) const;

  std::vector<geometry::Collider> colliders;

 private:
  struct Wall {
    double value, slope;
  };
  Wall wall(double s) const;
  // visit(distance, normal) for each plane wall that the collider is to a particle at world x.
  template <class Visit>
  void for_walls(const geometry::Collider& collider, const Vec3& x, Visit&& visit) const;
  Vec3 world(const Point<Real>& x) const;

  Vec3 origin_;
  double radius_, clearance_;
  std::vector<Wall> table_;  // at s = 0, h / 512, ... h, and once more
  std::vector<std::int32_t> near_;
  std::vector<Point<Real>> contributions_;
};

extern template class Boundary<float>;
extern template class Boundary<double>;

}  // namespace substep::pbf
