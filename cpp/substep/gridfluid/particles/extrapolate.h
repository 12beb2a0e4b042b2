// Velocities around a liquid, for particles that leave it and for what the pressure solve needs of
// faces near the surface.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/particles/transfer_to_grid.h"

namespace substep::gridfluid {

// Faces of weight 0 get the mean of those next to them that are known: in a first layer those next
// to faces of weight > 0, in the next those next to the first, and so on (Bridson, "Fluid
// simulation for computer graphics", 2015, section 7.1: averaging in a breadth-first order). So
// many layers are needed as cells that a particle passes in a step, and one. Faces further away
// keep what they have. Sets the ghosts.
template <class Real, int D>
class Extrapolation {
 public:
  void operator()(const Layout<D>& layout, const ConstFaces<Real, D>& weight,
                  const Faces<Real, D>& u, int layers, int threads);

 private:
  struct Rows;  // of the faces of a component
  void mark(const Layout<D>& layout, int c, const Real* weight, std::int64_t row);
  void fill(const Layout<D>& layout, int c, int layer, Real* u, std::int64_t row);

  // Of each face: the layer in which it became known, 0 for weight > 0. (Real, as the velocities,
  // so that both fill the same lanes.)
  static constexpr Real kUnknown = 255;
  std::array<AlignedBuffer<Real>, D> layer_;
  struct Range {
    int begin, end;  // all outside is not
  };
  std::array<std::vector<Range>, D> known_, unknown_;  // faces of each row
};

}  // namespace substep::gridfluid
