// What obstacles leave of a grid: the open part of each face, after Batty, Bertails and Bridson, "A
// fast variational framework for accurate solid-fluid coupling", 2007, with face areas in place of
// volumes as Ng, Min and Gibou, "An efficient fluid-solid coupling algorithm for single-phase
// flows", 2009. The sides of the box are none of it.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/geometry/collider.h"
#include "substep/gridfluid/grid/cells.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/pressure/near_colliders.h"

namespace substep::gridfluid {

using geometry::Vec3;

template <class Real, int D>
class Obstacles {
 public:
  // low: the lowest corner of the grid [m]; dx: a cell [m]. In two dimensions obstacles are cut at
  // z = 0. around: whether velocities are asked for beyond the faces that obstacles cut.
  Obstacles(const Layout<D>& layout, const Vec3& low, double dx,
            std::vector<geometry::Collider> obstacles, bool around = true);

  std::vector<geometry::Collider> colliders;

  // To be called when the colliders are where they act. Nothing is computed anew where none moved,
  // and only velocities where these alone changed.
  void find(int threads);
  // The same for distance() alone, where the rest is not asked for.
  void find_distance(int threads);

  const Layout<D>& layout() const { return layout_; }
  bool any() const { return !colliders.empty(); }
  bool moving() const { return moving_; }
  // Signed distance at nodes, in cells, exact within two of them; number i is that of the lowest
  // corner of cell i. Only if there are any.
  std::span<const Real> distance() const { return {distance_.data(), distance_.size()}; }
  // The open part of the face below cell i, from 0 to 1. Only if there are any.
  std::span<const Real> open(int axis) const { return of(open_, axis); }
  // The obstacles' own velocity at faces that are not all open, and a cell beyond if `around`;
  // elsewhere 0 [m/s]. Only if they move.
  std::span<const Real> velocity(int axis) const { return of(velocity_, axis); }
  // The same without turns that displace no fluid: see revolution.h.
  std::span<const Real> displacing(int axis) const {
    return of(rolling_ ? displacing_ : velocity_, axis);
  }
  struct Face {
    std::int64_t index;
    std::size_t collider;  // the nearest
  };
  // Those faces. Only if obstacles move or yield.
  const std::vector<Face>& faces_near(int axis) const { return near_[usize(axis)]; }
  // What part of the weights around the middle of cell i, as of particles (density.h), obstacles
  // leave: 1 away from them. Only if there are any.
  std::span<const Real> room() const { return {room_.data(), room_.size()}; }
  // Of the middle of cell i, in cells; exact near the surface.
  Real at_centre(std::int64_t i) const;
  Real at_face(std::int64_t i, std::size_t axis) const;  // of the middle of the face below it
  // The area, in faces, of the obstacles' surface in cell i, times its normal out of the fluid.
  std::array<Real, D> surface(std::int64_t i) const;

  // Cells in which the surface is, in their order.
  struct Cut {
    std::int64_t cell;
    std::size_t collider;  // the nearest to its middle
    // What is open of the half of the cell beside each of its faces, lower and upper along each
    // axis, less half of what is open of that face.
    std::array<std::array<Real, 2>, D> beside;
  };
  std::span<const Cut> cuts(int threads);

  // The middle of a cell, or of the face below it along an axis [m], and the collider nearest
  // there.
  Vec3 middle(std::int64_t i, int faces_of = -1) const;
  std::size_t nearest(const Vec3& x) const;

  Vec3 low;
  double dx;

 private:
  using Fields = std::array<AlignedBuffer<Real>, D>;
  static std::span<const Real> of(const Fields& fields, int axis) {
    return {fields[usize(axis)].data(), fields[usize(axis)].size()};
  }
  static constexpr Real kTouching = 1e-3;  // in cells: a node that is nearer is in the obstacle
  static constexpr int kWide = 8, kBlock = 4, kSmall = 2;  // nodes of blocks along an axis
  Vec3 world(const std::array<double, D>& x) const;
  const NearColliders& near_block(const std::array<int, D>& node) const;
  void find_near(const NearColliders& around, const Blocks<D>& blocks, std::int64_t block,
                 NearColliders& found) const;
  Vec3 middle_of(const std::array<int, D>& cell, int faces_of) const;
  NearestColliders find_nearest() const { return {colliders, balls_, lipschitz_}; }
  std::size_t nearest_of(const NearColliders& near, const Vec3& x) const;
  Real distance_at(const NearColliders& near, const std::array<double, D>& x) const;
  Real below_flat(const NearColliders& near, const std::array<double, D>& x,
                  const geometry::Collider& collider) const;
  bool is_flat(const geometry::Collider& collider, const Vec3& x) const;
  // Distances at the corners of the block that begins at a node and spans these axes: those upper
  // along the k-th of them by bit k.
  template <std::size_t kAxes>
  std::array<Real, std::size_t{1} << kAxes> at_corners(
      std::int64_t node, const std::array<std::size_t, kAxes>& axes) const {
    std::array<Real, std::size_t{1} << kAxes> d;
    for (std::size_t corner = 0; corner < d.size(); ++corner) {
      std::int64_t i = node;
      for (std::size_t k = 0; k < kAxes; ++k) i += (corner >> k & 1) * layout_.stride[axes[k]];
      d[corner] = distance_[usize(i)];
    }
    return d;
  }
  void find_distances(int threads);
  void find_distances_in(const NearColliders& nearby, const Blocks<D>& blocks, std::int64_t number,
                         NearColliders& around);
  // Of those that may be nearest in a cell.
  template <class Shape>
  bool all_near(const std::array<int, D>& cell) const;
  bool all_balls(const std::array<int, D>& cell) const;
  bool is_round(const std::array<int, D>& cell) const;
  template <std::size_t kAxes>
  bool is_sharp(const std::array<int, D>& cell, const std::array<std::size_t, kAxes>& axes) const;
  void find_open(int threads);
  void find_faces_near(int threads);
  void find_velocities(int threads);
  void find_room(int threads);

  Layout<D> layout_;
  bool around_;
  bool found_ = false, moving_ = false;  // distances; whether any collider moves
  bool rolling_ = false;                 // whether any turns in a way that displaces no fluid
  bool know_open_ = false, know_cuts_ = false, know_near_ = false, know_velocity_ = false;
  std::vector<std::array<double, geometry::Collider::kStateSize>> states_;  // that it was found for
  std::vector<Vec3> corners_;                                               // of facets then
  std::vector<bool> yield_;                                                 // which of them
  AlignedBuffer<Real> distance_, room_;
  Blocks<D> small_;
  std::vector<Ball> balls_;  // that colliders are
  double lipschitz_ = 1;     // of all signed distances
  NearColliders all_;
  std::vector<NearColliders>
      of_small_;  // around what is in a small block near a surface, else none
  Fields open_, velocity_, displacing_;
  std::array<std::vector<Face>, D> near_;
  std::vector<Cut> cuts_;
};

extern template class Obstacles<float, 2>;
extern template class Obstacles<float, 3>;
extern template class Obstacles<double, 2>;
extern template class Obstacles<double, 3>;

}  // namespace substep::gridfluid
