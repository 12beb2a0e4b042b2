// What happens at the sides of the box that a flow fills, and the ghost cells that say so.
//
// A number of a component of the velocity that is tangential to a side stands half a cell within
// it, as scalars do. Where a value is given at the side, the ghost beyond is the mirror image about
// it, 2 value - inside; where nothing passes, it is what is inside.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

enum class SideKind : std::uint8_t { kWall, kOpen, kPeriodic, kInflow };

struct Side {
  SideKind kind = SideKind::kWall;
  bool slip = true;              // of a wall: whether it lets the flow pass along it
  std::vector<double> velocity;  // D numbers for each of its faces in their order; none: 0 [m/s]
  std::vector<double> scalar;    // of each scalar: what flows in, or is held at a wall
  std::vector<bool> holds;       // of each scalar: whether a wall holds it, or its flux
};

template <int D>
using Sides = std::array<std::array<Side, 2>, D>;

template <class Real, int D>
class SideGhosts {
 public:
  SideGhosts(const Layout<D>& layout, const Sides<D>& sides, const std::vector<double>& ambient,
             double dx)
      : layout_(layout), sides_(sides), ambient_(ambient), dx_(dx) {}

  const Sides<D>& sides() const { return sides_; }
  bool is(std::size_t axis, std::size_t end, SideKind kind) const {
    return sides_[axis][end].kind == kind;
  }
  // Faces of an axis that the flow changes: not those of walls and inflows, and of a periodic axis
  // each once.
  Block<D> free_faces(std::size_t axis) const;
  // Of these, those with faces on both sides: not those in open sides.
  Block<D> inner_faces(std::size_t axis) const;

  // What is given of component a of the velocity at faces in walls and inflows.
  void set_normal(std::span<Real> u, std::size_t a, int threads) const;
  // Ghosts of component a of the velocity; of a change of it, to which all that is given is 0.
  void fill(std::span<Real> u, std::size_t a, int threads) const {
    fill_velocity(u, a, true, threads);
  }
  void fill_change(std::span<Real> u, std::size_t a, int threads) const {
    fill_velocity(u, a, false, threads);
  }
  // Ghosts of scalar k, with its diffusivity [m^2/s], and the velocities that pass open sides.
  void fill_scalar(std::span<Real> x, std::size_t k, double diffusivity, const Velocity<Real, D>& u,
                   int threads) const;
  // Of a change of it by diffusion alone.
  void fill_scalar_change(std::span<Real> x, std::size_t k, const Velocity<Real, D>& u,
                          int threads) const;

  // Component a of what is given at a side, for a cell or a face of that component.
  double given(std::size_t axis, std::size_t end, const std::array<int, D>& cell,
               std::size_t a) const;

 private:
  void fill_velocity(std::span<Real> u, std::size_t a, bool given_too, int threads) const;

  Layout<D> layout_;
  Sides<D> sides_;
  std::vector<double> ambient_;
  double dx_;
};

extern template class SideGhosts<float, 2>;
extern template class SideGhosts<float, 3>;
extern template class SideGhosts<double, 2>;
extern template class SideGhosts<double, 3>;

}  // namespace substep::gridfluid
