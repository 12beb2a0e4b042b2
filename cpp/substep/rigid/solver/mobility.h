// How bodies answer impulses: (v, w) += W (j, l), of the centre of mass and about it, in the world.
//
// A free body has W_0 = diag(1 / m, I^-1). Joints hold: with the gradients G of the equations of
// all joints of the bodies that hang together (joint_rows.h), and M^-1 the W_0 of all of them,
//   W = M^-1 - M^-1 G^T (G M^-1 G^T)^-1 G M^-1,
// of which each body gets its own block: what it does to the others, and contacts, are not in it.
// Limits, motors and springs hold nothing here, rods do.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/motion/bodies.h"
#include "substep/rigid/solver/joint.h"

namespace substep::rigid {

using Mat6 = Eigen::Matrix<double, 6, 6>;

// Of the bodies of `rows`, in their order; 0 unless dynamic. Bodies that more than 300 equations
// hold together count as free.
std::vector<Mat6> mobilities(const Bodies& bodies, std::span<const Joint> joints,
                             std::span<const std::int64_t> rows);

}  // namespace substep::rigid
