// Deep liquid without particles: cells that are further from the surface than a band live on the
// grid alone.
//
// Ferstl, Ando, Wojtan, Westermann and Thuerey, "Narrow band FLIP for liquid simulations", 2016.
// Deep cells count as full of particles that lie evenly: so much of the kernel of a particle as is
// in them adds to the density of a cell, and to the weight of a face with a velocity that went
// along the paths of the flow (semi_lagrangian.h). Where Ferstl et al. fill cells of the band that
// hold too few particles, here deep cells that liquid may leave in a step are filled before it
// (collar), what is in them moves with the other particles, and afterwards those in deep cells go:
// so as much comes into the band as flows there.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/flow/semi_lagrangian.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/grid/sides.h"
#include "substep/gridfluid/particles/particles.h"
#include "substep/gridfluid/particles/transfer_to_grid.h"

namespace substep::gridfluid {

template <class Real, int D>
class NarrowBand {
 public:
  using Flags = AlignedBuffer<std::uint8_t>;  // of the cells, with ghosts
  using Field = AlignedBuffer<Real>;

  NarrowBand(const Layout<D>& layout, const OpenSides<D>& open);

  // Of deep cells, and the velocities of the faces around them [m/s]; 0 elsewhere.
  const Flags& deep() const { return deep_; }
  const std::array<Field, D>& velocity() const { return u_; }
  std::int64_t count() const { return count(deep_); }
  std::int64_t seeded = 0;   // places that were drawn for particles, ever
  std::int64_t missing = 0;  // particles that the deep has taken beyond what it holds

  // What deep cells add to a density of 1 where all is full, and to velocities of faces with the
  // weights of so many particles to a full cell. Ghosts of densities are set.
  void add_density(Real* density, int threads);
  void add_velocity(Real particles, const Faces<Real, D>& u, const Faces<Real, D>& weight,
                    int threads);

  // Whether the number of particles in a cell is not for others to set right.
  bool fills(std::int64_t cell) const { return (deep_[usize(cell)] | edge_[usize(cell)]) != 0; }

  // Finds the edge, cells of the band beside deep ones, and of sorted particles which are too many
  // there and where there are too few, by their density with that of deep cells.
  void find_edge(const Particles<Real, D>& particles, const Real* density, const Real* phi,
                 int threads);
  // Rows of those that are too many.
  std::span<const std::int64_t> excess() const { return excess_; }

  // What will be deep after this step: cells around which, so many cells along each axis and
  // across, `liquid` is set. The ghosts of that are lost.
  void find_deep(Flags& liquid, int cells, int threads);
  bool will_be_deep(std::int64_t cell) const { return new_deep_[usize(cell)] != 0; }
  // Particles without velocities in the deep cells that have others within so many cells, and
  // where there are too few at the edge.
  Particles<Real, D> collar(int cells, bool affine, int threads);
  // Where the velocities, with ghosts, go in a step; reach: a step over a cell [s/m].
  void advect(const Velocity<Real, D>& u, double reach, int threads);
  // That so many particles came out of deep cells, and so many went.
  void account(std::int64_t came, std::int64_t gone);
  void commit() noexcept;

  // Of cells, and of the faces along each axis in turn, row by row.
  void save(std::vector<std::uint8_t>& deep, std::vector<Real>& velocity) const;
  void restore(std::span<const std::uint8_t> deep, std::span<const Real> velocity);

 private:
  std::int64_t count(const Flags& flags) const;
  const Field& part(int component, const Flags& deep, int threads);
  void draw(std::int64_t cell, const std::array<Real, D>& low, Real size);
  void erode(Flags& flags, int times, int threads);
  void fill_ghosts_of(Flags& flags, int axis, int threads) const;
  template <class Each>
  void for_faces(const Each& each) const;

  Layout<D> layout_;
  OpenSides<D> open_;
  SemiLagrangian<Real, D> paths_;
  Flags deep_, new_deep_, edge_, scratch_;
  std::array<Field, D> u_, new_u_;
  std::array<Field, 2> parts_;
  std::vector<std::int64_t> excess_;
  std::vector<Real> drawn_;  // places of new particles, row by row
  std::int64_t new_seeded_ = 0, new_missing_ = 0;
};

extern template class NarrowBand<float, 2>;
extern template class NarrowBand<float, 3>;
extern template class NarrowBand<double, 2>;
extern template class NarrowBand<double, 3>;

}  // namespace substep::gridfluid
