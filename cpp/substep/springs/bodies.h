// Rigid bodies that yield to what pushes them (geometry/collider.h), as unknowns of a step of
// implicit Euler beside the positions of the vertices.
//
// With the velocity V* = V + h a that a body has if nothing pushes it, and its mobility W = B B^T,
// the step finds V = V* + B z. The incremental potential gains |z|^2 / 2, and barrier and friction
// depend on V: the centre of mass goes from c_n to c = c_n + h v, the turn R_n to exp(h w) R_n.
// For an element with gradient G and block H (those of its vertex, all friction included), and
// r = x - c,
//
//   g_z = z - h B^T (G, Jl^T (r x G)),   a change of z moves the surface at x by A dz,
//   A = h (B_v - [r] Jl B_w),            rows of the border: -H A, its corner: 1 + A^T H A,
//
// where Jl(h w) is the left Jacobian of the exponential map, so that this is the gradient of one
// function of x and z. The barrier turns with the body, which adds to the Hessian what is left of
//   -(dx - dc) . (G x t) + ((G . t) (r . t) - (G . r) |t|^2) / 2,   dc = h B_v dz, t = h Jl B_w dz.
// B is of the range of W: a body on a hinge only turns about it, whatever its V*. What the step
// found is then given back as impulses (geometry::push_bodies).
//
// Simplifications: W is that of the start of the step, and friction takes r from where it lagged.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "substep/springs/contact.h"

namespace substep::springs {

using geometry::Mat6;
using geometry::Vec6;
using Mat36 = Eigen::Matrix<double, 3, 6>;

// Gradients and, for a border, blocks of the elements of barrier and friction.
struct ContactElements {
  const Vec3 *barrier, *friction;
  const Mat3 *barrier_blocks, *friction_blocks;
};

// What bodies add to the matrix of the vertices: for each element that touches one a block of
// rows of its vertex, and a corner for each body. No two bodies meet in an element.
struct Border {
  struct Touch {
    std::int32_t vertex;
    Mat36 block;
  };
  std::vector<std::vector<Touch>> touches;
  std::vector<Mat6> corners;
};

class Bodies {
 public:
  Bodies(Contacts& contacts, const BarrierTerm& barrier, const FrictionTerm& friction)
      : contacts_(contacts), barrier_(barrier), friction_(friction) {}

  // Starts a step of length h of the bodies that yield, which accelerate here. Their unknowns are
  // two vectors of 3 each, scaled to metres by the mean of the masses of the vertices, such that
  // their gradient in newtons is one of a vertex of that mass. Places them where they move least.
  void begin_step(double h, std::span<const double> masses);
  // Where bodies have been placed by begin_step(), and where they go with the velocities that they
  // had before.
  std::vector<Vec3> start() const { return all(&Body::start); }
  std::vector<Vec3> coasting() const { return all(&Body::coasting); }

  // Moves the colliders to where the unknowns say, with the velocities they say.
  void place(Positions unknowns);
  double energy(Positions unknowns) const;
  // At the unknowns that place() was given, and vertices x.
  void gradient(Positions x, const ContactElements& elements, std::span<Vec3> g) const;
  Border border(Positions x, const ContactElements& elements, double kept) const;
  // Term::step_bound of the barrier of all bodies that yield, which place() has put at `unknowns`.
  double step_bound(Positions x, Positions dx, Positions unknowns, Positions change) const;

  // After exchange() of the colliders is set: the bodies have the velocities that it gives them.
  void push();

 private:
  struct Body {
    std::vector<std::size_t> colliders;
    std::vector<std::size_t> surfaces;        // of those
    Mat6 basis;                               // B, for unknowns in metres
    double inertia;                           // in place of 1 for these [kg / s^2]
    Vec6 free;                                // V*
    Vec6 start, coasting;                     // unknowns: the body moves least, or as it did
    Vec3 centre;                              // c_n
    std::vector<geometry::Quaternion> turns;  // R_n of each collider
    Mat3 jacobian;                            // Jl where the body is now
  };
  std::vector<Vec3> all(Vec6 Body::* unknowns) const;
  Vec6 velocity(const Body& body, const Vec3* unknowns) const;
  double reach(const Body& body, std::size_t s, const Vec3& x, const Vec3& dx, const Vec6& v,
               const Vec6& dv) const;
  Contacts& contacts_;
  const BarrierTerm& barrier_;
  const FrictionTerm& friction_;
  std::vector<Body> bodies_;
  double h_ = 0.0;
};

}  // namespace substep::springs
