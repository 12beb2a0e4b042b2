// Where something is: a point of the body or shape at `p` of its own frame is at R p + x.
#pragma once

#include "substep/geometry/vectors.h"

namespace substep::rigid {

using geometry::Mat3;
using geometry::Quaternion;
using geometry::Vec3;

// The rotation is kept as a matrix: it is made once per step and used by every pair.
struct Pose {
  Vec3 position = Vec3::Zero();
  Mat3 rotation = Mat3::Identity();

  Pose() = default;
  Pose(const Vec3& x, const Mat3& R) : position(x), rotation(R) {}
  Pose(const Vec3& x, const Quaternion& q) : position(x), rotation(q.toRotationMatrix()) {}

  Vec3 to_world(const Vec3& p) const { return rotation * p + position; }
  Vec3 to_local(const Vec3& x) const { return rotation.transpose() * (x - position); }

  // The pose of what stands at `local` in the frame of this one.
  Pose operator*(const Pose& local) const {
    return {to_world(local.position), Mat3(rotation * local.rotation)};
  }
  // The pose of this one as seen from the frame of `frame`.
  Pose relative_to(const Pose& frame) const {
    return {frame.to_local(position), Mat3(frame.rotation.transpose() * rotation)};
  }
};

}  // namespace substep::rigid
