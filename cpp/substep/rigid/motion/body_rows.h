// The bodies of one step in the coordinates in which all of them have mass 1 and inertia 1:
//   v' = sqrt(m) v,  w' = W^(-1/2) w  with  W = R I^-1 R^T,  W^(1/2) = R I^(-1/2) R^T.
// An impulse l with the gradient j of its constraint in these coordinates changes velocities by
// l j and reads them by j . (v', w'): one vector serves both, and a mass is 1 / (j . j).
//
// The world inertia is that of the start of the step throughout, but for rows that turn, which roll
// on something: theirs is that of the sub-step. The angular momentum gets the impulses; the
// rotation is the free one of the whole step, turned by what the impulses added. A body that they
// would turn far, by more than half a radian, turns freely with the new momentum instead, as if it
// had had it from the start, where its energy is what the impulses made it.
//
// Only bodies that may move have a row. All static and sleeping ones share row 0, which is at rest
// and has W^(1/2) = 0 and 1 / sqrt(m) = 0, so that impulses do nothing to it.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/core/point.h"
#include "substep/core/usize.h"
#include "substep/rigid/motion/bodies.h"

namespace substep::rigid {

// Six numbers of a body, one cache line.
struct alignas(64) BodyRow {
  Point<double> linear, angular;
};

struct BodyRows {
  using Rows = AlignedBuffer<BodyRow>;

  Rows velocity;
  Rows free;          // what it would be without the contacts and joints of this sub-step
  Rows push;          // what those of the last sub-step changed
  Rows acceleration;  // by gravity, forces and torques
  Rows displacement;  // since the start of the step, rotation as a vector
  // W^(1/2): linear (xx, yy, zz, 1 / sqrt(m)), angular (xy, xz, yz, 1 if impulses move it, else 0).
  // A kinematic body has 1 for its mass and moments, so that its velocity is read as it is.
  Rows root;
  std::vector<std::uint8_t> stands;           // of rows; row 0 does
  std::vector<std::uint8_t> turns;            // of rows: what turn() is called for
  std::vector<std::uint8_t> led;              // of rows: joints alone say where they are in the end
  std::vector<std::int32_t> row_of, body_of;  // row_of[body], body_of[row]; body_of[0] is -1

  std::int64_t size() const { return static_cast<std::int64_t>(body_of.size()); }
  // Of the body, or of the world where it is below 0.
  std::int32_t row(std::int32_t body) const { return body < 0 ? 0 : row_of[usize(body)]; }
  bool moves(std::int32_t row) const { return root[usize(row)].angular.w != 0; }
  Mat3 root_of(std::int32_t row) const;  // W^(1/2)
  double scale_of(std::int32_t row) const { return root[usize(row)].linear.w; }

  // asleep: not 0 where a body is, or empty.
  void load(const Bodies& bodies, const Vec3& gravity, std::span<const std::uint8_t> asleep,
            int threads);
  // For all but those that are led: v += h a + push: the contacts push as they did in the last
  // sub-step. Bodies that stand and are slower than `slow` [m/s] first lose up to the part `lost`
  // of their velocity.
  void accelerate(std::int64_t begin, std::int64_t end, double h, double slow, double lost);
  // x += h v, and notes the push. A body that nothing touched is on its parabola:
  // x += h v - h^2 a / 2, exactly.
  void move(std::int64_t begin, std::int64_t end, double h);
  // Where the body is in this sub-step.
  Pose pose(const Bodies& bodies, std::int32_t body) const;
  Vec3 velocity_of(std::int32_t row) const;
  Vec3 spin_of(std::int32_t row) const;
  // Where one that is there now will be after h with its momenta of now, and how it will spin
  // there.
  Pose pose_after(const Bodies& bodies, std::int32_t body, const Pose& now, double h,
                  Vec3& spin) const;
  // After move(): q, W^(1/2) and what is in its coordinates become those of the sub-step's end, by
  // the free rotation with L. The push is for the contacts to renew.
  void turn(const Bodies& bodies, std::int32_t row, double h, FreeRotation method);
  // To bodies, after a step of dt. Returns the first body whose motion is not finite, or -1; then
  // nothing was stored.
  std::int64_t store(Bodies& bodies, double dt, FreeRotation method, int threads) const;

 private:
  Quaternion rotation(const Bodies& bodies, std::int32_t body) const;
  Vec3 momentum_of(std::int32_t row) const { return root_of(row).inverse() * spin_row(row); }
  Vec3 spin_row(std::int32_t row) const;
  std::int64_t first_not_finite(const Bodies& bodies) const;
  bool turns_anew(std::int64_t row, double dt) const;

  AlignedBuffer<double> first_spin_;  // w' at the start, (rows, 3)
  AlignedBuffer<double> turned_;      // rotations of the rows that turn, (rows, 4)
};

}  // namespace substep::rigid
