// Contact of particles with rigid bodies that yield (geometry/collider.h): the position-based
// correction of both (Mueller et al., "Detailed rigid body simulation with extended position based
// dynamics", 2020, eq. 2 to 8), with mobilities in place of their inverse masses.
//
// A particle of inverse mass w whose way ends C too near a body gets, with the mobility K of the
// body's material at that place and the normal n,
//   dx = w lambda n,   lambda = C / (w + n . K n),
// and the body the impulse -lambda n / h there: its velocity changes at once, and its pose by what
// that change brings in the substep h. Friction stops the way s of the particle along the surface,
// that of the body included: the sum of the tangential corrections is cut to friction times that of
// the normal ones. Contacts are solved one after the other, by collider and particle, in a few
// sweeps after each iteration over the constraints; on the calling thread.
//
// Deviation: no restitution. A body that yields takes all approach from what it touches.
#pragma once

#include <map>
#include <span>
#include <utility>
#include <vector>

#include "substep/geometry/particle_contact.h"

namespace substep::pbd {

template <class Real>
class BodyContact {
 public:
  // Bodies accelerate, and all obstacles advance by h.
  void begin_substep(geometry::ParticleContact<Real>& contact, double h);
  // For what ParticleContact::project() leaves; the arguments are the same.
  void project(geometry::ParticleContact<Real>& contact, std::span<const Point<Real>> start,
               std::span<Point<Real>> x, std::span<const Real> mass);

 private:
  using Vec3 = geometry::Vec3;
  struct Sums {
    double normal = 0;  // [kg m], as the other
    Vec3 tangential = Vec3::Zero();
  };
  struct Pair;
  void find(const geometry::ParticleContact<Real>& contact, std::span<const Point<Real>> start,
            std::span<const Point<Real>> x, std::span<const Real> mass);
  bool solve(Pair pair, Sums& sums) const;
  void rub(Pair pair, const Vec3& n, Sums& sums) const;

  double h_ = 0;
  std::vector<std::pair<std::size_t, std::int32_t>> near_;     // collider, particle
  std::map<std::pair<std::size_t, std::int32_t>, Sums> sums_;  // of the substep
};

}  // namespace substep::pbd
