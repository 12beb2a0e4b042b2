// Bodies of revolution: a pressure acts through the middle of a ball and through the axis of a
// capsule or a cylinder, so that it does not turn them about it, and such turns displace no fluid.
// On a grid the parts of faces that they cover would do both by their errors.
#pragma once

#include <variant>

#include "substep/geometry/collider.h"

namespace substep::gridfluid {

// P, for which P omega is what of a turn about position() moves the surface along its normal, and
// P t what of the torque about it a pressure gives. In two dimensions balls alone, which are discs
// wherever they are cut.
template <int D>
geometry::Mat3 turns_of_pressure(const geometry::Collider& collider) {
  const geometry::Shape& shape = collider.shape();
  if (std::holds_alternative<geometry::Sphere>(shape)) return geometry::Mat3::Zero();
  const bool round = std::holds_alternative<geometry::Capsule>(shape) ||
                     std::holds_alternative<geometry::Cylinder>(shape);
  if (D == 2 || !round) return geometry::Mat3::Identity();
  const geometry::Vec3 axis = collider.rotation().col(2);
  return geometry::Mat3::Identity() - axis * axis.transpose();
}

}  // namespace substep::gridfluid
