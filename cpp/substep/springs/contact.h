// Frictional contact of vertices with colliders (Li et al., "Incremental potential contact",
// SIGGRAPH 2020), as terms of the incremental potential.
//
// Barrier (their eq. 6), for the distance d of a vertex from an obstacle, within a thickness D:
//   b(d) = -(d - D)^2 ln(d / D)  for 0 < d < D,   0 for d >= D,   infinite for d <= 0,
//   b'   = -2 (d - D) ln(d / D) - (d - D)^2 / d,
//   b''  = -2 ln(d / D) - 4 (d - D) / d + (d - D)^2 / d^2,
//   W = k b(d),   g = k b' n,   H = k (b'' n n^T + b' grad n)   with n = grad d.
// The force -k b' grows without bound as d falls to 0, and step_bound() stops every step before
// d = 0: vertices never pass. The obstacle pushes from a distance below D on.
//
// Friction (their eqs. 13 and 18): with the normal force N = -k b' and n lagged, the sliding
// velocity u = (1 - n n^T) (v - v_surface), y = |u| and the speed e below which contact counts as
// sticking,
//   D = mu N f0(y),  f0' = f1,  f1(y) = 2 y / e - y^2 / e^2 for y < e, else 1,
//   g = mu N f1(y) / y u,   H = mu N (f1' t t^T + f1 / y (1 - n n^T - t t^T)),  t = u / y.
// Newton's method on u alone goes far beyond where a vertex comes to rest, as f1' is 0 up to there.
// So it is that on u and w = f1 / y u together, y / f1 w = u (Chan, Golub and Mulet, "A nonlinear
// primal-dual method for total variation-based image restoration", 1999, eq. 3.6), with
//   H = mu N f1 / y (1 - n n^T - (y / f1)' (w t^T + t w^T) / 2),
// where w, no longer than 1, is what the last iteration foresaw; at w = f1 t that is H above.
// So a body that sticks creeps, slower than e. lag() takes N and n from positions; once a minimum
// is found the solver lags there again, until nothing is left to do.
//
// Deviations: distances of vertices only (an edge or face between vertices may cut a corner of an
// obstacle: choose D above e^2 / (8 R) for edges of length e and radii R), and one k per vertex
// in place of their adaptive one: m / h^2 is the scale of the inertial term.
#pragma once

#include <algorithm>
#include <compare>
#include <cstdint>
#include <limits>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/surfaces.h"
#include "substep/springs/term.h"

namespace substep::springs {

// a x b = cross_matrix(a) b
Mat3 cross_matrix(const Vec3& a);

struct Contacts {
  std::vector<geometry::Collider> colliders;
  std::vector<double> stiffness;  // k of each vertex [N/m]; 0: it passes through (pinned vertices)
  double thickness = 1e-3;        // D [m]
  double sticking_speed = 1e-3;   // e [m/s]

  std::int64_t vertices() const { return static_cast<std::int64_t>(stiffness.size()); }
};

// A surface of the colliders, and a vertex that may touch it.
struct ContactPair {
  std::int32_t surface, vertex;
  auto operator<=>(const ContactPair&) const = default;
};
// Those that are by vertices, by surfaces.
std::vector<ContactPair> by_surface(std::span<const ContactPair> pairs, std::size_t surfaces);

// Elements of both terms are pairs, ascending: those alone that balls about the obstacles do not
// keep apart. A hollow box has three surfaces, one for each pair of walls, a hollow cylinder two:
// the distance from all of them has a kink where two are as near, and Newton's method finds no
// minimum in an edge.
class ContactTerm : public Term {
 public:
  explicit ContactTerm(const Contacts& contacts);
  std::span<const geometry::Surface> surfaces() const { return surfaces_; }
  int arity() const override { return 1; }
  std::span<const std::int32_t> vertices() const override { return vertices_; }
  bool roves() const override { return true; }
  std::int64_t lists() const override { return lists_; }
  // Those of a fixed number of pairs of all surfaces and vertices, as if all were elements: so sums
  // do not depend on who is left out.
  std::int64_t part_end(std::int64_t e, std::int64_t grain) const override;
  std::span<const ContactPair> pairs() const { return pairs_; }

 protected:
  // All pairs at x whose distance may be at most reach(vertex), and few others.
  std::vector<ContactPair> pairs_within(Positions x, const auto& reach) const;
  void set_pairs(std::vector<ContactPair> pairs);

  const geometry::Surface& surface(std::int64_t e) const {
    return surfaces_[usize(pairs_[usize(e)].surface)];
  }
  const geometry::Collider& collider(std::int64_t e) const {
    return contacts_.colliders[surface(e).collider];
  }
  geometry::SignedDistance distance(std::int64_t e, const Vec3& x) const {
    return geometry::signed_distance(collider(e), surface(e).axis, x);
  }
  // The stiffness of the vertex of element e.
  double stiffness(std::int64_t e) const { return contacts_.stiffness[usize(vertices_[e])]; }
  const Contacts& contacts_;
  std::vector<geometry::Surface> surfaces_;
  std::vector<ContactPair> pairs_;
  std::vector<std::int32_t> vertices_;
  std::int64_t lists_ = 0;
  bool endless_;  // no surface is bounded: every pair is an element
};

class BarrierTerm : public ContactTerm {
 public:
  using ContactTerm::ContactTerm;
  void find(Positions x) override;
  double energy(Positions x, std::int64_t begin, std::int64_t end) const override;
  void derivatives(Positions x, std::int64_t begin, std::int64_t end, double kept, Vec3* gradient,
                   Mat3* hessian) const override;
  // Of all pairs. Without colliders that yield, which are those of Bodies::step_bound.
  double step_bound(Positions x, Positions dx, std::int64_t begin, std::int64_t end) const override;
};

// Its elements are the pairs that touched where it lagged.
class FrictionTerm : public ContactTerm {
 public:
  using ContactTerm::ContactTerm;
  bool dissipative() const override { return true; }
  void lag(Positions x) override;
  // From the centre of mass of the body that element e rubs to where it did so when it lagged.
  const Vec3& arm(std::int64_t e) const { return lagged_[usize(e)].arm; }
  void arrive(Positions v, std::int64_t begin, std::int64_t end) override;
  double energy(Positions v, std::int64_t begin, std::int64_t end) const override;
  void derivatives(Positions v, std::int64_t begin, std::int64_t end, double kept, Vec3* gradient,
                   Mat3* hessian) const override;

 private:
  struct Lagged {
    double bound;  // mu N [N]
    Vec3 normal;
    Vec3 surface_velocity;  // of what does not yield
    Vec3 arm;
    bool arrived = false;                     // anywhere since it lagged:
    Vec3 u = Vec3::Zero(), w = Vec3::Zero();  // where, and w there
  };
  // At a sliding velocity: f1 / y, and (y / f1)' t.
  struct Slip {
    double ratio;
    Vec3 slope;
  };
  Slip slip(const Vec3& u) const;
  Vec3 sliding_velocity(std::int64_t e, Positions v) const;
  std::vector<Lagged> lagged_;
};

// function(vertex, b, f) for the pairs of a surface that are elements of one or both terms: their
// numbers there, -1 where a pair is none.
void for_pairs(const ContactTerm& barrier, const ContactTerm& friction, std::size_t surface,
               const auto& function) {
  const auto first = [&](const ContactTerm& term, std::size_t s) {
    const auto pairs = term.pairs();
    const ContactPair from{static_cast<std::int32_t>(s), 0};
    return std::lower_bound(pairs.begin(), pairs.end(), from) - pairs.begin();
  };
  std::int64_t b = first(barrier, surface), f = first(friction, surface);
  const std::int64_t b_end = first(barrier, surface + 1), f_end = first(friction, surface + 1);
  while (b < b_end || f < f_end) {
    const std::int32_t in_b = b < b_end ? barrier.vertices()[usize(b)] : INT32_MAX;
    const std::int32_t in_f = f < f_end ? friction.vertices()[usize(f)] : INT32_MAX;
    const std::int32_t i = std::min(in_b, in_f);
    function(i, in_b == i ? b++ : -1, in_f == i ? f++ : -1);
  }
}

inline constexpr double kKept = 0.1;  // of a distance, at least, after one step towards an obstacle

// The largest s in (0, 1] for which kKept is left of the distance at the start, where distance(s)
// changes no faster than `speed`: within distance / speed there is no surface (conservative
// advancement).
double march(double start, double speed, const auto& distance) {
  const double spare = (1.0 - kKept) * start;
  if (speed <= spare) return 1.0;
  double s = spare / speed;
  for (int step = 0; step < 200 && s < 1.0; ++step) {
    const double left = distance(s) - kKept * start;
    if (left < 1e-3 * start) return s;
    s += left / speed;
  }
  return std::min(s, 1.0);
}

// What the colliders were given in a step of length h that ended at x with velocities v: minus the
// impulses of barrier and friction on the vertices. Sets their exchange().
void set_exchanges(Contacts& contacts, BarrierTerm& barrier, const FrictionTerm& friction,
                   Positions x, Positions v, double h);

// Vertices that the colliders, which were `before`, have come upon go aside, or along with them
// where that does not do, so that a step can start where nothing penetrates. Those that a surface
// slides past stay.
void carry_vertices(const std::vector<geometry::Collider>& before, const Contacts& contacts,
                    std::span<Vec3> x);

// Vertices inside of a collider, as where it was put upon them, go to the distance at which it
// begins to push. Whether there were any, and all of them have found a place.
bool set_off_vertices(const Contacts& contacts, std::span<Vec3> x);

// For explicit integrators, after a step: vertices inside of a collider return to its surface; a
// normal velocity v_n < 0 relative to it becomes -restitution v_n, and friction takes at most mu
// times that impulse from the sliding velocity (Coulomb). Bodies that yield take part in each of
// these impacts, one after the other. Sets the colliders' exchange().
void project_contacts(Contacts& contacts, std::span<const double> masses, std::span<Vec3> x,
                      std::span<Vec3> v);

// The lowest distance of a vertex of positive stiffness from a collider; infinite without any that
// is not further than `within`.
struct Closest {
  double distance;
  std::int64_t vertex, collider;  // -1: none
};
Closest closest_vertex(const Contacts& contacts, Positions x,
                       double within = std::numeric_limits<double>::infinity());

}  // namespace substep::springs
