// The state of rigid bodies: rows of arrays, in the order in which bodies were added.
//
// A body is at x with its centre of mass, turned by q, with linear momentum P and angular momentum
// L (about its centre, in the world). Velocities are derived: v = P / m, w = R I^-1 R^T L.
//
// Bodies that are not moved by forces have mass and moments 1: P is their velocity and L their
// angular velocity, and they move by the same equations. They do not count in sums.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/motion/free_rotation.h"
#include "substep/rigid/shapes/pose.h"

namespace substep::rigid {

enum class Motion : std::uint8_t {
  kDynamic,    // by forces and impulses
  kKinematic,  // at the velocities it was given
  kStatic      // not at all
};

// One body as its owner describes it, at rest or moving.
struct BodyState {
  Vec3 position = Vec3::Zero();
  Quaternion rotation = Quaternion::Identity();  // of the principal frame; is normalised
  Vec3 velocity = Vec3::Zero();
  Vec3 angular_velocity = Vec3::Zero();
  Motion motion = Motion::kDynamic;
  double mass = 1;              // [kg], dynamic bodies only
  Vec3 inertia = Vec3::Ones();  // principal moments [kg m^2], dynamic bodies only
};

class Bodies {
 public:
  std::int64_t size() const { return static_cast<std::int64_t>(mass.size()); }

  // Returns the number of the new body. InputError: something is not finite, the quaternion is 0,
  // the mass or the moments are none of a body, a static body moves; nothing was added then.
  std::int64_t add(const BodyState& body);
  void make_room(std::size_t more);  // so that adding so many does not take memory
  // The numbers that bodies have from now on, -1 for the removed: those behind move up. InputError:
  // a number is out of range.
  std::vector<std::int64_t> remove(std::span<const std::int64_t> removed);
  void remove_last();  // takes no memory

  Vec3 position(std::int64_t i) const { return Vec3(&x[3 * usize(i)]); }
  Quaternion rotation(std::int64_t i) const { return load_quaternion(&q[4 * usize(i)]); }
  Pose pose(std::int64_t i) const { return {position(i), rotation(i)}; }
  bool dynamic(std::int64_t i) const { return motion[usize(i)] == Motion::kDynamic; }
  Vec3 velocity(std::int64_t i) const { return Vec3(&P[3 * usize(i)]) / mass[usize(i)]; }
  Vec3 angular_velocity(std::int64_t i) const;
  Vec3 velocity_at(std::int64_t i, const Vec3& point) const {
    return velocity(i) + angular_velocity(i).cross(point - position(i));
  }
  // What an impulse sees: 0 for bodies that none moves.
  double inverse_mass(std::int64_t i) const { return dynamic(i) ? 1 / mass[usize(i)] : 0; }
  Mat3 inverse_inertia(std::int64_t i) const;  // in the world

  void set_velocity(std::int64_t i, const Vec3& velocity);
  void set_angular_velocity(std::int64_t i, const Vec3& angular_velocity);
  void set_velocity(std::int64_t i, const Vec3& velocity, const Vec3& angular_velocity);
  // Forces [N] and impulses [N s] at a point of the world; of no effect unless dynamic.
  void apply_force(std::int64_t i, const Vec3& F, const Vec3& point);
  void apply_impulse(std::int64_t i, const Vec3& J, const Vec3& point);

  // P += dt (m g + F), L += dt T for dynamic bodies; the forces stay until clear_forces().
  void kick(double dt, const Vec3& gravity, int threads = 0);
  void clear_forces();
  // x += dt v, and the free rotation by dt. Returns the first body whose state is not finite after
  // it, or -1.
  std::int64_t drift(double dt, FreeRotation method, int threads = 0);

  // Of the dynamic bodies, summed in their order.
  double kinetic_energy() const;                       // [J]
  double potential_energy(const Vec3& gravity) const;  // - sum of m g . x [J]
  Vec3 momentum() const;                               // [kg m/s]
  Vec3 angular_momentum() const;                       // about the origin [kg m^2/s]

  // Rows, for those who work on many bodies; sizes change with add and remove only.
  std::vector<double> x, q, P, L;     // (n, 3), (n, 4) as (w, x, y, z), (n, 3), (n, 3)
  std::vector<double> mass, inertia;  // (n), (n, 3)
  std::vector<double> force, torque;  // (n, 3), about the centre
  std::vector<Motion> motion;
};

}  // namespace substep::rigid
