// Fills a closed or nearly closed surface with tetrahedra: Labelle and Shewchuk, "Isosurface
// stuffing: fast tetrahedral meshes with good dihedral angles", SIGGRAPH 2007 (section numbers
// below), with one size of tetrahedra throughout.
//
// The surface enters by the sign of its distance only, inside where the winding number says so, so
// holes, seams and self-intersections do no harm. Parts thinner than the lattice get lost, edges
// are rounded at its size. Deviation from the paper: the cut points are refined by bisection of
// the sign where the field jumps (across a hole), by the secant elsewhere.
#pragma once

#include <array>
#include <vector>

#include "substep/geometry/triangle_tree.h"

namespace substep::geometry {

struct Tetrahedra {
  std::vector<Vec3> vertices;
  std::vector<std::array<std::int64_t, 4>> cells;  // right-handed
};

// spacing: edge of the cubes of the body-centred lattice [m], which are its long edges.
Tetrahedra stuff_isosurface(const TriangleTree& tree, double spacing, int threads);

}  // namespace substep::geometry
