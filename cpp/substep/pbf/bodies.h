// Obstacles that yield (geometry::BodyBehind) within the step of a fluid.
//
// The constraints that a body takes part in are rows c_i - d_i mu_i - q_i . xi <= 0, mu_i >= 0,
// with equality where mu_i > 0: c_i what is violated, d_i what a unit of the multiplier mu_i does
// to it by the particle, q_i what the motion xi of the body does, and xi = W sum_i mu_i q_i. So the
// body counts in the denominators (Macklin et al., "Unified particle physics for real-time
// applications", 2014). Deviation: there each row is divided by its own d_i + q_i^T W q_i, and many
// particles together overshoot a light body, or need its mass split among them (Tonge et al., "Mass
// splitting for jitter-free parallel rigid body simulation", 2012). Here the rows of a body are
// solved together: as they have only its motion in common, by Newton's method on the six equations
//   (1 + W sum_{mu_i > 0} q_i q_i^T / d_i) xi = W sum_{mu_i > 0} q_i c_i / d_i.
// A massless body so moves to where what pushes it balances. In every sweep these are the rows of
// the density, then those of contact. Lengths are those of a sweep, masses in units of m_0.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/particle_contact.h"
#include "substep/pbf/density.h"

namespace substep::pbf {

using geometry::Mat6;
using geometry::Vec6;
using geometry::wrench;

struct BodyRow {
  std::int32_t particle = 0, collider = 0;
  Vec6 q = Vec6::Zero();
  double c = 0, d = 1, mu = 0;
};

// Finds mu; returns xi. Where all is two-sided mu may have either sign.
Vec6 solve_rows(const Mat6& w, std::span<BodyRow> rows, bool one_sided);
// (1 + W K)^-1 W f.
Vec6 respond(const Mat6& w, const Mat6& k, const Vec6& f);

// A particle near collider c, or nozzle c after the colliders, and the part of c in grad b.
template <class Real>
struct NearWall {
  std::int32_t particle, collider;
  Point<Real> gradient;
};

template <class Real>
struct YieldingBody {
  std::vector<std::size_t> colliders;
  Mat6 mobility;                           // times m_0
  Vec6 base, velocity = base;              // before anything pushed it; with what did so far
  Vec6 pace = base;                        // the velocity that moves it in this step
  Vec6 xi = Vec6::Zero();                  // in the last sweep
  std::vector<NearWall<Real>*> near = {};  // by particles
  std::vector<BodyRow> rows = {};
  bool shares = false;  // particles with other bodies

  // Its velocity by such multipliers of the rows.
  Vec6 gained(std::span<const Real> multipliers) const {
    Vec6 sum = Vec6::Zero();
    for (const BodyRow& row : rows) sum += double(multipliers[usize(row.particle)]) * row.q;
    return mobility * sum;
  }
};

template <class Real>
class YieldingBodies {
 public:
  using Contact = geometry::ParticleContact<Real>;
  using Body = YieldingBody<Real>;

  bool empty() const { return bodies_.empty(); }
  std::span<const Body> bodies() const { return bodies_; }

  // Before the colliders move by dt. m0: mass in kg of a particle whose inverse mass is 1.
  void begin(const Contact& contact, double m0, double dt, int dimension);
  // Who is near them, until the next begin().
  void note(std::span<std::vector<NearWall<Real>>> near);
  // Changes the multipliers of a sweep so that the bodies' motion is counted.
  void share(const Contact& contact, std::span<const Point<Real>> x,
             std::span<const DensityRow<Real>> density, bool one_sided,
             std::span<Point<Real>> multipliers);
  // Counts what the sweep pushed, and moves the bodies.
  void push(Contact& contact, std::span<const Point<Real>> multipliers,
            std::span<const Point<Real>> x, std::span<const Real> mass);
  // Parts particles and bodies that met.
  void meet(Contact& contact, std::span<const Point<Real>> start, std::span<Point<Real>> x,
            std::span<const Real> mass);
  // Coulomb's friction on the velocities v.
  void rub(Contact& contact, std::span<const Point<Real>> x, std::span<Point<Real>> v,
           std::span<const Real> mass);
  void accelerate(Contact& contact, double dt);
  // Rows of all bodies with q as along(i, grad b) turns it.
  template <class Along>
  void set_rows(const Contact& contact, std::span<const Point<Real>> x, const Along& along);
  // After the contact's end_step().
  void end(Contact& contact);

 private:
  Vec6 gather(Contact& contact, Body& body) const;
  void follow(Contact& contact, Body& body);
  Vec3 arm(const Contact& contact, const Body& body, const Point<Real>& x) const;

  struct Start {
    Vec3 position;
    geometry::Quaternion orientation;
  };
  std::vector<Body> bodies_;
  std::vector<Start> starts_;  // of all colliders
  std::vector<Vec3> pushes_;
  std::vector<double> pull_;  // of all bodies on each particle's constraint
  double m0_ = 1, h_ = 0;
  bool planar_ = false;
};

template <class Real>
Vec3 YieldingBodies<Real>::arm(const Contact& contact, const Body& body,
                               const Point<Real>& x) const {
  Vec3 from = xyz(x) + (contact.origin() - contact.colliders[body.colliders[0]].centre());
  if (planar_) from[2] = 0;
  return from;
}

template <class Real>
template <class Along>
void YieldingBodies<Real>::set_rows(const Contact& contact, std::span<const Point<Real>> x,
                                    const Along& along) {
  for (Body& body : bodies_) {
    body.rows.clear();
    for (const NearWall<Real>* near : body.near) {
      if (xyz(near->gradient).isZero(0)) continue;
      if (body.rows.empty() || body.rows.back().particle != near->particle) {
        body.rows.push_back({near->particle, near->collider});
      }
      body.rows.back().q += wrench(arm(contact, body, x[usize(near->particle)]),
                                   along(near->particle, near->gradient));
    }
  }
}

extern template class YieldingBodies<float>;
extern template class YieldingBodies<double>;

}  // namespace substep::pbf
