// Obstacles in an implicit step: which components of a node's velocity are given, and what the
// obstacle does to it.
//
// Every node in a collider (node_distances.h) is in contact with it. At the end of the step its
// velocity u relative to the surface, and the impulse r that holds it there, satisfy
//   sticky    u = 0
//   slip      u.n = 0
//   separate  u.n >= 0,  r.n >= 0,  (u.n) (r.n) = 0                    (Signorini)
// and along the surface Coulomb's law, |r_t| <= mu max(r.n, 0), with r_t against u_t where it is
// less than that does not suffice to hold the node. The solver solves for given states (free,
// sliding with a given rubbing impulse, held) and update() then compares: a node that is pulled
// lets go, one that would enter is taken, friction follows the pressure. Repeated until nothing
// changes, this is an active set method for Signorini's conditions (Nocedal, Wright, "Numerical
// Optimization", 2nd ed., section 16.5) with friction lagged by one round.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/boundary.h"
#include "substep/mpm/implicit_nodes.h"
#include "substep/mpm/node_distances.h"

namespace substep::mpm {

template <int D>
class ImplicitContacts {
 public:
  using Vec3 = geometry::Vec3;

  template <class Real>
  void assign(const ImplicitNodes<D>& nodes, const NodeDistances<Real, D>& distances,
              std::span<const geometry::Collider> colliders, std::span<const Boundary> boundaries,
              double cell);

  // States from what velocities v would do without other forces.
  void predict(std::span<const double> v);
  // States from the solution v and the impulses r that the given components took [N s]; whether
  // they changed by more than `tolerance` of the impulse.
  bool update(std::span<const double> v, std::span<const double> r, double tolerance);

  // x <- P x: the free components.
  void project(std::span<double> x) const;
  // v <- P v + the given components.
  void impose(std::span<double> v) const;
  // Makes v admissible, whatever the states: nothing enters.
  void keep_out(std::span<double> v) const;
  // r -= the rubbing impulses on the nodes.
  void subtract_friction(std::span<double> r) const;
  // Sum of rubbing impulse . v: their potential is its negative.
  double friction_work(std::span<const double> v) const;

  // What each collider was given, from the impulses r on the nodes.
  std::vector<geometry::Exchange> exchanges(std::span<const double> r) const;
  bool empty() const { return nodes_in_contact_.empty(); }

 private:
  struct Contact {
    std::int32_t collider;
    Vec3 normal, surface_velocity, arm;  // arm: from the collider's position to the node
    double friction;
    Boundary boundary;
    bool active;
  };
  struct ContactNode {
    std::size_t node;
    std::size_t first, count;  // contacts
    double mass;
    bool held = false;                                   // sticks: all components are given
    Vec3 friction = Vec3::Zero();                        // rubbing impulse of a node that slides
    Eigen::Matrix3d free = Eigen::Matrix3d::Identity();  // P
    Vec3 given = Vec3::Zero();
  };
  // The active normals of a node, made orthogonal, and what is along them.
  struct Frame;

  void rebuild(ContactNode& node);
  Frame frame(const ContactNode& node) const;

  std::vector<Contact> contacts_;
  std::vector<ContactNode> nodes_in_contact_;
  std::size_t colliders_ = 0;
};

}  // namespace substep::mpm
