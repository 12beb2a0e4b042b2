// Obstacles in an implicit step: which components of a node's velocity are given, and what the
// obstacle does to it.
//
// Every node in a collider (node_distances.h) is in contact with it. At the end of the step its
// velocity u relative to the surface, and the impulse r that holds it there, satisfy
//   sticky    u = 0
//   slip      u.n = 0
//   separate  u.n >= 0,  r.n >= 0,  (u.n) (r.n) = 0                    (Signorini)
// The solver solves for a given set of nodes that touch, and update() then compares: a node that is
// pulled lets go, one that would enter is taken. Repeated until nothing changes, this is an active
// set method (Nocedal, Wright, "Numerical Optimization", 2nd ed., section 16.5).
//
// Friction is Coulomb's with the pressing impulse of the round before (mu sum max(r.n, 0) =: b),
// made smooth where the node hardly slips (Li et al., "Incremental potential contact", ACM TOG 39
// (2020) 49, section 5.4): with y = |u_t| the potential of the impulse -b f_1(y) u_t / y is b f_0,
//   f_1 = 2 y / e - y^2 / e^2,  f_0 = y^2 / e - y^3 / (3 e^2) + e / 3   for y < e, the slip speed,
//   f_1 = 1,                    f_0 = y                                 else.
// So what sticks creeps at less than e.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/boundary/boundary.h"
#include "substep/mpm/boundary/node_distances.h"
#include "substep/mpm/implicit/nodes.h"

namespace substep::mpm {

template <int D>
class ImplicitContacts {
 public:
  using Vec3 = geometry::Vec3;

  template <class Real>
  void assign(const ImplicitNodes<D>& nodes, const NodeDistances<Real, D>& distances,
              std::span<const geometry::Collider> colliders, std::span<const Boundary> boundaries,
              double cell);

  // Which nodes touch, and how they are pressed, by what velocities v would do without other
  // forces. slip_speed: e [m/s], which begins `smoothing` times that and comes down from round to
  // round.
  void predict(std::span<const double> v, double slip_speed, double smoothing);
  // How they are pressed by impulses r.
  void press(std::span<const double> r);
  // The same from the solution v and the impulses r that hold the nodes there [N s]; whether it
  // changed: an impulse by more than `tolerance` of all, or a velocity by more than the slip speed.
  bool update(std::span<const double> v, std::span<const double> r, double tolerance);

  // x <- P x: the free components.
  void project(std::span<double> x) const;
  // v <- P v + the given components.
  void impose(std::span<double> v) const;
  // Makes v admissible, whatever touches: nothing enters.
  void keep_out(std::span<double> v) const;

  // Friction's potential, its gradient, its Hessian at the last linearise (symmetric, positive
  // semidefinite).
  double energy(std::span<const double> v) const;
  void add_gradient(std::span<const double> v, std::span<double> r) const;
  void linearise(std::span<const double> v);
  void add_product(std::span<const double> x, std::span<double> y) const;
  void add_diagonal(std::span<double> blocks) const;

  // What each collider was given, from the impulses r on the nodes.
  std::vector<geometry::Exchange> exchanges(std::span<const double> r) const;

 private:
  struct Contact {
    std::int32_t collider;
    Vec3 normal, surface_velocity, arm;  // arm: from the collider's position to the node
    double friction;
    Boundary boundary;
    bool active;  // touches
  };
  struct ContactNode {
    std::size_t node;
    std::size_t first, count;  // contacts
    double mass;
    bool sticky;
    double bound = 0;                                    // b
    Eigen::Matrix3d free = Eigen::Matrix3d::Identity();  // P
    Vec3 given = Vec3::Zero();                           // components
    Vec3 surface = Vec3::Zero();                         // velocity that u_t is relative to
    Eigen::Matrix3d curvature = Eigen::Matrix3d::Zero();
  };
  // The active normals of a node, made orthogonal, and what is along them.
  struct Frame;

  void rebuild(ContactNode& node);
  Frame frame(const ContactNode& node) const;
  Vec3 slip(const ContactNode& node, std::span<const double> v) const;

  std::vector<Contact> contacts_;
  std::vector<ContactNode> nodes_in_contact_;
  std::size_t colliders_ = 0;
  double slip_speed_ = 0, least_slip_speed_ = 0;
};

}  // namespace substep::mpm
