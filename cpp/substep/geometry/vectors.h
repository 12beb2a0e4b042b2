// Vectors and matrices of space, one spelling for all folders.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "substep/core/point.h"

namespace substep::geometry {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using Quaternion = Eigen::Quaterniond;

}  // namespace substep::geometry

namespace substep {

// A row's position or velocity, without what its owner keeps beside it.
template <class Real>
geometry::Vec3 xyz(const Point<Real>& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

}  // namespace substep
