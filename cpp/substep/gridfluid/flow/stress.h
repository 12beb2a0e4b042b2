// What a flow gives to obstacles, by the balance of momentum around them.
//
// A weight w is 1 beside an obstacle and 0 some cells off. What comes in where it falls off and
// does not stay in the fluid within is what the obstacle gets: its momentum equation times w,
// summed over the cells (John and Matthies, "Higher-order finite element discretizations in a
// benchmark problem for incompressible flows", 2001). So nothing is asked of cells that the surface
// cuts, but how fast their velocities change.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

template <class Real, int D>
class Stress {
 public:
  void find(const Layout<D>& layout, const Obstacles<Real, D>& obstacles,
            std::span<const Cell> cells, int threads);

  struct Step {
    Velocity<Real, D> before, after;  // with ghosts
    std::span<const double> q;        // pressure times dt / (density cell) [m/s]
    std::span<const Real> density;    // of cells, in parts of that of `mass`; empty: 1
    double mass;                      // of a full cell [kg]
    double courant, shear;            // dt, and kinematic viscosity times it, over a cell [s/m, m]
    std::function<double(std::int64_t, std::size_t)> pull;  // on a cell, along an axis [m/s]

    double density_of(std::int64_t i) const {
      return density.empty() ? 1 : double(density[usize(i)]);
    }
  };
  // Sets exchange() of the obstacles' colliders.
  void push(const Layout<D>& layout, Obstacles<Real, D>& obstacles, std::span<const Cell> cells,
            const Step& step, int threads) const;

 private:
  struct Near {
    std::int64_t cell;
    std::size_t collider;
    double weight, room;  // room: the part of the cell that is open
  };
  Vec3 through(const Layout<D>& layout, std::span<const Cell> cells, const Step& step,
               std::int64_t i, std::size_t axis, bool upper) const;

  std::vector<Near> near_;
};

extern template class Stress<float, 2>;
extern template class Stress<float, 3>;
extern template class Stress<double, 2>;
extern template class Stress<double, 3>;

}  // namespace substep::gridfluid
