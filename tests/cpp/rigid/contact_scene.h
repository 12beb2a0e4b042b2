// Bodies in contact, for tests of contact solvers: every pair is looked at in every step.
#pragma once

#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "constants.h"
#include "substep/core/usize.h"
#include "substep/rigid/collision/narrow_phase.h"
#include "substep/rigid/solver/contact_solver.h"

namespace substep::rigid {

struct ContactScene {
  Bodies bodies;
  std::vector<Shape> shapes;
  std::vector<double> friction, restitution;
  std::vector<ContactConstraint> contacts;
  ContactSolver solver;
  ContactOptions options;
  Vec3 gravity{0, 0, -9.81};
  double spinning = 0, rolling = 0;
  std::vector<std::uint8_t> asleep;
  std::vector<Joint> joints;
  int threads = 1;

  std::int32_t add(const Shape& shape, const BodyState& body) {
    shapes.push_back(shape);
    friction.push_back(0.5);
    restitution.push_back(0);
    return static_cast<std::int32_t>(bodies.add(body));
  }
  std::int32_t add_ground() {
    BodyState body;
    body.motion = Motion::kStatic;
    return add(Plane{Vec3::UnitZ(), 0}, body);
  }
  std::int32_t add_box(const Vec3& half, const Vec3& position, double mass = 1) {
    BodyState body;
    body.position = position;
    body.mass = mass;
    const Vec3 s = half.cwiseProduct(half);
    body.inertia = mass / 3 * Vec3(s.y() + s.z(), s.x() + s.z(), s.x() + s.y());
    return add(Box{half}, body);
  }
  std::int32_t add_sphere(double radius, const Vec3& position, double mass = 1) {
    BodyState body;
    body.position = position;
    body.mass = mass;
    body.inertia = Vec3::Constant(0.4 * mass * radius * radius);
    return add(Sphere{radius}, body);
  }

  void find_contacts(double dt) {
    std::map<std::pair<std::int32_t, std::int32_t>, ContactConstraint> last;
    for (const ContactConstraint& c : contacts) last.emplace(std::pair(c.a, c.b), c);
    contacts.clear();
    const auto n = static_cast<std::int32_t>(bodies.size());
    for (std::int32_t a = 0; a < n; ++a) {
      for (std::int32_t b = a + 1; b < n; ++b) {
        if (!bodies.dynamic(a) && !bodies.dynamic(b)) continue;
        const Pose pose_a = bodies.pose(a), pose_b = bodies.pose(b);
        const double margin =
            0.02 + dt * (bodies.velocity(a) - bodies.velocity(b)).norm() + dt * dt * gravity.norm();
        Manifold manifold;
        Cache cache;
        if (!collide(shapes[usize(a)], pose_a, shapes[usize(b)], pose_b, margin, manifold, cache))
          continue;
        ContactConstraint contact = make_contact(manifold, a, pose_a, b, pose_b);
        contact.friction = std::sqrt(friction[usize(a)] * friction[usize(b)]);
        contact.restitution = std::max(restitution[usize(a)], restitution[usize(b)]);
        contact.spinning = spinning, contact.rolling = rolling;
        if (const auto old = last.find({a, b}); old != last.end()) {
          carry_impulses(old->second, contact);
        }
        contacts.push_back(contact);
      }
    }
  }
  void step(double dt) {
    find_contacts(dt);
    solver.step(bodies, gravity, dt, contacts, options, asleep, joints, threads);
  }
  void advance(double duration, double dt = 1. / 60) {
    for (int k = 0; k < std::lround(duration / dt); ++k) step(dt);
  }

  // Deepest point of the contacts of the last step [m].
  double penetration() const {
    double deepest = 0;
    for (const ContactConstraint& c : contacts) {
      for (int k = 0; k < c.count; ++k) deepest = std::max(deepest, -c.points[k].separation);
    }
    return deepest;
  }
  double energy() const { return bodies.kinetic_energy() + bodies.potential_energy(gravity); }
};

}  // namespace substep::rigid
