// How bodies answer impulses: (v, w) += W (j, l), of the centre of mass and about it, in the world.
//
// A free body has W_0 = diag(1 / m, I^-1). Joints hold: with the gradients G of the equations of
// all joints of the bodies that hang together (joint_rows.h), and M^-1 the W_0 of all of them,
//   W = M^-1 - M^-1 G^T (G M^-1 G^T)^-1 G M^-1.
// The coordinates of rods are held too, and those of motors that are strong enough, as the caller
// says. A damped spring of stiffness k and damping c yields in its equation by 1 / D over a step
// dt, D = dt^2 k / 4 + dt c / 2 of joint_law.h, on the diagonal of G M^-1 G^T. Limits and springs
// that ring on hold nothing here, and contacts are not in it.
//
// Whoever pushes several bodies and knows each by a block of its own must not take it for stiffer
// than W: else what one push does to the others comes as a surprise, and grows. With W_0 = R R^T of
// each body and W_kj = R_k S_kj R_j^T, the blocks R_k (S_kk + sum_j |S_kj|) R_k^T, over the bodies
// j that are pushed as well, |C| = (C C^T)^1/2, are together at least W: for any x and y, 2 x.C y
// <= x.|C| x + y.|C^T| y. A body that is pushed alone has its own block of W.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/motion/bodies.h"
#include "substep/rigid/solver/joint.h"

namespace substep::rigid {

using Mat6 = Eigen::Matrix<double, 6, 6>;

// Of each joint, which part of the strength of its motor the last step took: 0 of rods, which have
// no end of it, 1 of what has no motor.
std::vector<double> parts_of_strength(std::span<const Joint> joints);

// Those blocks of the bodies of `rows`, which are pushed, in their order, over a step dt; 0 unless
// dynamic. Bodies that more than 150 equations hold together count as free. `held`: of each joint,
// 1 if its motor is strong enough.
std::vector<Mat6> mobilities(const Bodies& bodies, std::span<const Joint> joints,
                             std::span<const std::uint8_t> held, std::span<const std::int64_t> rows,
                             double dt);

}  // namespace substep::rigid
