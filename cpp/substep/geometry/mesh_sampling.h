// The signed distance of a triangle mesh on the nodes of a regular grid.
#pragma once

#include <array>

#include "substep/geometry/triangle_tree.h"

namespace substep::geometry {

// Of an open mesh it is that of the solid where the winding number is above 1/2, whose holes are
// closed by the level w = 1/2, sampled at the spacing.
//
// distance[(i * n_y + j) * n_z + k] at origin + spacing (i, j, k), below 0 inside.
void sample_signed_distance(const TriangleTree& tree, const std::array<std::int64_t, 3>& shape,
                            const Vec3& origin, double spacing, double* distance, int threads);

}  // namespace substep::geometry
