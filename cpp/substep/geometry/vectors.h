// Vectors and matrices of space, one spelling for all folders.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace substep::geometry {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;
using Quaternion = Eigen::Quaterniond;

}  // namespace substep::geometry
