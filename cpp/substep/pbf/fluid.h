// A position-based fluid in time (Macklin and Mueller, "Position based fluids", 2013, algorithm 1).
#pragma once

#include <span>
#include <vector>

#include "substep/geometry/neighbours.h"
#include "substep/geometry/particle_flow.h"
#include "substep/pbf/boundary.h"
#include "substep/pbf/density.h"
#include "substep/pbf/forces.h"
#include "substep/pbf/options.h"
#include "substep/pbf/particles.h"
#include "substep/pbf/projection.h"

namespace substep::pbf {

template <class Real>
class Fluid {
 public:
  // Positions are stored from `origin` on.
  Fluid(const Vec3& origin, std::vector<geometry::Collider> colliders, const FluidOptions& options,
        geometry::ParticleFlow flow = {});

  // Puts particles at the end, at rest or with velocities; returns the id of the first.
  std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v,
                   std::span<const std::int32_t> fluid);
  void remove(std::span<const std::uint8_t> flags);  // by row
  // Throws InputError with the index of a point too far from the origin for cells to be numbered.
  void check_reach(std::span<const Vec3> x) const;

  // One step, with what comes out of emitters and goes into sinks at its end, or an exception and
  // nothing has changed.
  void step(double dt);

  // The largest speed that a particle has, or gains by falling to the lowest one's height [m/s]:
  // u^2 = max_i (v_i^2 + 2 g . (x_lowest - x_i)).
  double fastest() const;
  Energies energies() const;
  // v sum_j W + b of each row, now.
  std::vector<Real> densities() const;

  double mass(std::int64_t row) const { return options.masses[particles.fluid[row]]; }
  Vec3 world(const Point<Real>& x) const {
    return origin +
           Vec3(static_cast<double>(x.x), static_cast<double>(x.y), static_cast<double>(x.z));
  }
  Point<Real> local(const Vec3& x, Real w) const;

  FluidOptions options;
  Vec3 origin;
  DensityConstraint<Real> density;
  Boundary<Real> boundary;
  Particles<Real> particles;
  geometry::ParticleFlow flow;
  FluidReport report;
  double time = 0;
  double last_dt = 0;  // 0 before the first step
  std::int64_t next_id = 0;

 private:
  bool begin(double dt);
  void uncover(double dt);
  void predict(double dt);
  void keep_in_reach();
  void keep_velocities(double dt);
  void act_on_velocities(double dt);
  void correct(double dt);
  void accelerate(double dt);
  void project(double dt);
  void add_response(std::span<const YieldingBody<Real>> bodies);
  void sort();
  void warm_start(double dt);
  void solve(double tolerance, double max_tolerance);
  void finish(double dt);
  void keep_in_bounds();
  void let_flow(double end);
  void commit(double dt) noexcept;

  void append(Particles<Real>& to, std::int64_t first_id, std::span<const Vec3> x,
              std::span<const Vec3> v, std::span<const std::int32_t> fluid) const;
  std::int64_t absorb(Particles<Real>& from, const geometry::Collider& region) const;

  Real inverse_mass(std::int32_t fluid) const;
  std::span<const Point<Real>> now() const { return std::span(next_.x).first(old_x_.size()); }
  typename Forces<Real>::Rows rows() const;
  Point<Real> gravity() const;
  template <class Velocity>
  void refuse_bad_velocity(const Velocity& velocity) const;

  // During a step: the particles in the order of their cells, and what they will be when it ends.
  Particles<Real> next_;
  geometry::ParticleFlow::Counts new_counts_;
  std::int64_t new_next_id_ = 0;
  std::vector<Point<Real>> predicted_, old_x_, old_v_, multipliers_;
  std::vector<DensityRow<Real>> density_rows_;  // where obstacles yield
  std::vector<Real> mass_;                      // of each particle, or one for all [kg]
  geometry::Neighbours<Real> neighbours_;
  Forces<Real> forces_;
  VelocityProjection<Real> projection_;
  std::vector<Real> lambda_;
  std::vector<Point<Real>> pushes_;  // of walls, in the projection
  FluidReport new_report_;
};

extern template class Fluid<float>;
extern template class Fluid<double>;

}  // namespace substep::pbf
