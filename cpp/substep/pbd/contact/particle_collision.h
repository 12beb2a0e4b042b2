// Contact of particles with each other: balls that do not overlap, with friction.
//
//   C = |x_0 - x_1| - (r_0 + r_1) >= 0,   dC/dx_0 = n = (x_0 - x_1) / |x_0 - x_1| = -dC/dx_1,
//
// corrected by inverse masses w (Mueller et al. 2007, eq. 10 and 11):
//   dx_0 = -w_0 / (w_0 + w_1) C n,   dx_1 = w_1 / (w_0 + w_1) C n,
// so that momentum stays. Friction takes of the tangential way s = (1 - n n^T) ((x_0 - x_0^old) -
// (x_1 - x_1^old)) the part min(1, friction |C| / |s|) (Macklin et al., "Unified particle physics",
// 2014, eq. 24). Particles that are closer than their radii at rest keep 0.99 of that instead, so
// that a rope of overlapping particles exerts nothing on itself.
//
// The pairs of a substep are those nearer than the radii and a margin at the predicted positions;
// they are projected one after the other, in cell order, on the calling thread. A particle that
// moves by more than about its radius in a substep may pass another one.
#pragma once

#include "substep/geometry/neighbours.h"
#include "substep/pbd/groups/group.h"

namespace substep::pbd {

template <class Real>
class ParticleCollision : public Group<Real> {
 public:
  // By the indices of the user: radii [m], 0 for particles that collide with nothing, and positions
  // at rest (three numbers each).
  ParticleCollision(std::vector<double> radii, std::vector<double> rest, double friction);

  std::unique_ptr<Group<Real>> clone() const override;
  std::int64_t size() const override { return 0; }  // contacts come and go
  void attach(const Partition& partition) override;
  bool prepares() const override { return true; }
  void prepare(const Sweep<Real>& s, int threads) override;
  bool serial() const override { return true; }
  int phases() const override { return 1; }
  std::int64_t chunks(int) const override { return 1; }
  std::int64_t project(int phase, std::int64_t chunk, const Sweep<Real>& s) override;

 private:
  struct Contact {
    std::int32_t a, b;
    Real distance;
  };

  std::vector<double> radii_, rest_;
  Real friction_;
  std::vector<std::int32_t> balls_;           // slots of particles with a radius
  std::vector<Real> radius_;                  // of balls_
  std::vector<std::array<double, 3>> start_;  // of balls_
  Real largest_ = 0;
  geometry::Neighbours<Real> near_;
  std::vector<Point<Real>> points_, sorted_;
  std::vector<Contact> contacts_;
};

}  // namespace substep::pbd
