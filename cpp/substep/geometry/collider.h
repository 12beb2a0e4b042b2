// The obstacle of every method: a shape, where it is, how it moves and rubs, and what it was given.
//
// A step of any method reads signed_distance(x), surface_velocity(x), friction and restitution, and
// gives back the impulses it exerted on the collider: collect them in an Exchange per chunk of
// vertices, add the chunks in their order, and hand the sum to set_exchange once per step. So the
// sums are the same bits for any number of threads. The method that steps calls advance(dt) once
// per step; a Collider is a value, so a copy taken before restores it after a step that failed.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <variant>
#include <vector>

#include "substep/geometry/height_field.h"
#include "substep/geometry/sampled_distance.h"

namespace substep::geometry {

// What a collider was given: impulse [N s] and torque impulse about its position [N m s].
struct Exchange {
  Vec3 impulse = Vec3::Zero();
  Vec3 torque = Vec3::Zero();

  void add(const Vec3& arm, const Vec3& j) {  // arm: point of action minus position()
    impulse += j;
    torque += arm.cross(j);
  }
  Exchange& operator+=(const Exchange& other) {
    impulse += other.impulse;
    torque += other.torque;
    return *this;
  }
};

using Vec6 = Eigen::Matrix<double, 6, 1>;
using Mat6 = Eigen::Matrix<double, 6, 6>;

inline Vec6 joined(const Vec3& first, const Vec3& second) {
  Vec6 both;
  both.head<3>() = first;
  both.tail<3>() = second;
  return both;
}
// Force and torque, or impulse and angular impulse, of what acts at `arm`.
inline Vec6 wrench(const Vec3& arm, const Vec3& force) { return joined(force, arm.cross(force)); }

// The body behind an obstacle that yields to what pushes it. In vectors of six the first three
// belong to the centre of mass, the others to the turning about it, in the world: an impulse j
// changes the velocity by mobility j. Colliders of one number are one body. Below 0 an obstacle
// moves as it is told, whatever pushes it: its mobility is 0.
struct BodyBehind {
  int number = -1;
  Vec3 centre = Vec3::Zero();        // of mass, in the frame of the collider [m]
  Mat6 mobility = Mat6::Zero();      // [1/kg], [1/(kg m)], [1/(kg m^2)]
  Vec6 acceleration = Vec6::Zero();  // without what pushes the obstacle [m/s^2], [rad/s^2]
  Vec6 received = Vec6::Zero();      // sum of what push_bodies() gave [N s], [N m s]
  // Facets of one surface, each a body of its own, have its number here, and those that act at a
  // distance act by the nearest one alone. Below 0 it is no facet.
  int surface = -1;
};

using Shape = std::variant<Plane, Sphere, Box, std::shared_ptr<const SampledDistance>, Capsule,
                           Cylinder, std::shared_ptr<const HeightField>, Triangle>;

// Whether a shape of this kind is convex, whatever its numbers.
inline bool is_convex(const Shape& shape) {
  return !std::holds_alternative<std::shared_ptr<const SampledDistance>>(shape) &&
         !std::holds_alternative<std::shared_ptr<const HeightField>>(shape);
}

// The distance of a capsule or a cylinder on the nodes of a grid, of which 24 span its radius, but
// at most 128 the longest side: for what is made of sampled distances.
std::shared_ptr<const SampledDistance> sampled(const Shape& shape, int threads);

class Collider {
 public:
  // `hollow` turns the solid inside out: the obstacle is then all space outside of the shape.
  Collider(Shape shape, const Vec3& position, bool hollow = false);

  // Signed distance of the world point x [m], below 0 inside the obstacle, and its exact gradient:
  // of length 1, but for sampled distances, where it is about 1 (normalise it for a normal). A
  // point outside may move by value / lipschitz() and does not enter the obstacle.
  SignedDistance signed_distance(const Vec3& x) const;
  // The same in the frame of the collider, whose origin is position().
  SignedDistance local_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz() const;
  // v + omega x (x - position) [m/s].
  Vec3 surface_velocity(const Vec3& x) const;

  // Moves by velocity dt, or a body's centre of mass by its own, and turns by angular_velocity dt.
  void advance(double dt);

  // For those that yield: the centre of mass in the world, the velocity of the body, and exchange()
  // about its centre of mass.
  bool yields() const { return body.number >= 0; }
  Vec3 centre() const { return position_ + rotation_ * body.centre; }
  Vec6 body_velocity() const;
  void set_body_velocity(const Vec6& velocity);
  Vec6 body_impulse() const;

  const Vec3& position() const { return position_; }
  void set_position(const Vec3& position) { position_ = position; }
  const Quaternion& orientation() const { return orientation_; }  // body to world
  const Mat3& rotation() const { return rotation_; }              // of orientation()
  void set_orientation(const Quaternion& orientation);            // normalised here
  bool hollow() const { return sign_ < 0; }
  const Shape& shape() const { return shape_; }
  // What deforms has another shape now, and shapes() counts how often: for those that keep
  // distances.
  void set_shape(const Shape& shape) {
    shape_ = shape;
    ++shapes_;
  }
  std::int64_t shapes() const { return shapes_; }

  const Exchange& exchange() const { return exchange_; }
  void set_exchange(const Exchange& exchange) { exchange_ = exchange; }

  // What it was given in the last call of a simulation that took steps, and the time [s] of those:
  // the steps after begin_call(), each added by end_step() with its exchange(). No part of state().
  void begin_call() { begins_ = true; }
  void end_step(double dt) {
    if (begins_) total_ = {}, duration_ = 0;
    begins_ = false;
    total_ += exchange_;
    duration_ += dt;
  }
  const Exchange& total() const { return total_; }
  double duration() const { return duration_; }

  // What it goes on from: position, orientation (w, x, y, z), velocity, angular velocity, friction,
  // restitution. Not what it was given: restore() sets that to 0.
  static constexpr std::size_t kStateSize = 15;
  std::array<double, kStateSize> state() const;
  void restore(const std::array<double, kStateSize>& state);

  double friction = 0;                   // Coulomb's coefficient
  double restitution = 0;                // normal velocity after / before, 0 to 1
  Vec3 velocity = Vec3::Zero();          // of position() [m/s]
  Vec3 angular_velocity = Vec3::Zero();  // in the world frame [rad/s]
  BodyBehind body;                       // no part of state(): whoever couples sets it

 private:
  Shape shape_;
  Vec3 position_;
  Quaternion orientation_ = Quaternion::Identity();
  Mat3 rotation_ = Mat3::Identity();  // of orientation_
  double sign_;
  std::int64_t shapes_ = 0;
  Exchange exchange_, total_;
  double duration_ = 0;
  bool begins_ = true;
};

// A step of length dt of obstacles that yield, before anything pushes them: their bodies'
// velocities change by acceleration dt. To be called before the method's own solve, which adds
// mobility times the impulse that it finds.
void accelerate_bodies(std::span<Collider> colliders, double dt);
// After the exchange() of the step is set, and before its positions change: the velocities of the
// bodies change by mobility times the sum over their colliders, which `received` counts.
void push_bodies(std::span<Collider> colliders);
// The colliders of each body that yields, by ascending numbers; in their order.
std::vector<std::vector<std::size_t>> colliders_by_body(std::span<const Collider> colliders);

}  // namespace substep::geometry
