// What obstacles do to a fluid: a share of the density near them (wall_integrals.h, density_map.h),
// and no way through (geometry/particle_contact.h).
//
// An obstacle is taken as filled with the liquid, in layers that begin as far behind its surface as
// the particle is before it (Mirror): so a lattice half a spacing from plane walls is at rest, and
// liquid that settled fills its volume. The density constraint pushes a particle off an obstacle by
// w_i lambda_i grad b_i; that, and what the contact adds, is what the obstacle is given.
// Deviation: in two dimensions boxes are taken as long along z, balls as discs of their radius, and
// all others as planes at their nearest points.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <variant>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/particle_contact.h"
#include "substep/pbf/bodies.h"
#include "substep/pbf/density.h"
#include "substep/pbf/density_map.h"
#include "substep/pbf/nozzle.h"
#include "substep/pbf/symmetric.h"
#include "substep/pbf/wall_integrals.h"

namespace substep::pbf {

template <class Real>
class Boundary {
 public:
  Boundary(std::vector<geometry::Collider> obstacles, std::span<const geometry::Emitter> emitters,
           const DensityConstraint<Real>& density, const Vec3& origin, int threads);

  // Where the layers of the emitters that have not come out are in what follows, at a time when so
  // many have.
  void place_layers(std::span<const std::int64_t> come, double time);
  // A step of length dt from `start` to the predicted x: obstacles move, particles they cover are
  // set free, and who may come near one is noted. mass [kg]: of each particle, or one for all; of
  // those whose inverse mass is 1: reference_mass. Returns whether any were covered.
  bool begin_step(double dt, std::span<Point<Real>> start, std::span<Point<Real>> x,
                  std::span<const Real> mass, double reference_mass, int threads);
  // Who is near an obstacle, or a nozzle, at x, where nothing moves.
  void find_near(std::span<const Point<Real>> x, int threads);
  // Rows (grad b_i, b_i) at x, one for each particle, 0 away from all obstacles.
  std::span<const Point<Real>> contributions(std::span<const Point<Real>> x, int threads);
  // Whether obstacles yield. Then a sweep needs the rows of the density, and share() changes the
  // multipliers of particles near them so that their motion is counted.
  bool yields() const { return !bodies_.empty(); }
  void share(std::span<const Point<Real>> x, std::span<const DensityRow<Real>> density,
             bool one_sided, std::span<Point<Real>> multipliers) {
    bodies_.share(contact_, x, density, one_sided, multipliers);
  }
  // Bodies whose rows have along(i, grad b) for the gradient.
  template <class Along>
  std::span<const YieldingBody<Real>> rows_of_bodies(std::span<const Point<Real>> x,
                                                     const Along& along) {
    bodies_.set_rows(contact_, x, along);
    return bodies_.bodies();
  }
  void accelerate_bodies(double dt) { bodies_.accelerate(contact_, dt); }
  // After a sweep that moved particles by w_i lambda_i grad b_i, with lambda_i in the w of
  // `multipliers`: counts that as pushed, and moves them so that none is in an obstacle.
  void project(std::span<const Point<Real>> multipliers, std::span<const Point<Real>> start,
               std::span<Point<Real>> x, std::span<const Real> mass, int threads);
  // Their part of M_i (projection.h): b (I - n n^T) + s |grad b| n n^T at the distance s from a
  // wall.
  std::span<const Symmetric<Real>> moments(std::span<const Point<Real>> x, int threads);
  // visit(i, grad b of one wall or nozzle, its velocity at x_i, collider or -1) by particles'
  // chunks.
  template <class Visit>
  void for_near(std::span<const Point<Real>> x, const Visit& visit, int threads) const;
  // Collider c pushed particle i otherwise than by project(): the particle's velocity changed by
  // dv.
  void add_impulse(std::int32_t c, std::int64_t i, const Point<Real>& x, const Vec3& dv, double dt,
                   double mass) {
    contact_.add_push(usize(c), i, x, dt * dv, mass);
  }
  // The part of what project() moves that becomes velocity.
  void set_share(double share) { contact_.share = share; }
  // Coulomb's friction on the velocities v, for what add_impulse() and the first project() pushed.
  void slide(std::span<const Point<Real>> x, std::span<Point<Real>> v, std::span<const Real> mass) {
    contact_.slide(x, v, mass);
  }
  // Restitution on the velocities v, friction on bodies that yield, and what the obstacles were
  // given.
  void end_step(std::span<const Point<Real>> start, std::span<const Point<Real>> v_start,
                std::span<const Point<Real>> x, std::span<Point<Real>> v,
                std::span<const Real> mass);

  std::vector<geometry::Collider>& colliders() { return contact_.colliders; }
  const std::vector<geometry::Collider>& colliders() const { return contact_.colliders; }

 private:
  // How b is found, one for each collider.
  struct Flat {};
  struct Facet {};  // as Flat, where it is the nearest one of its surface
  struct Tank {};   // the inside of a box
  struct Block {};  // a solid box
  using Wall = std::variant<Flat, Facet, std::shared_ptr<const DistanceTable>, Tank, Block,
                            std::shared_ptr<const DensityMap>>;
  using Near = NearWall<Real>;

  void note_near(std::span<const Point<Real>> x, int threads);
  Vec3 velocity_of(std::size_t c, const Vec3& x) const;
  WallDensity density_of(std::size_t c, const Vec3& x) const;
  void find_nearest(std::span<const Point<Real>> x, std::span<const Near> near);
  bool other_is_nearer(const Near& entry) const;
  WallDensity wall_density(std::size_t c, const Vec3& local) const;
  WallDensity in_tank(const Vec3& half_lengths, const Vec3& x) const;

  geometry::ParticleContact<Real> contact_;
  double radius_, spacing_;
  int dimension_;
  std::vector<Wall> walls_;
  std::vector<Nozzle> nozzles_;
  std::shared_ptr<const Mirror> mirror_;
  std::shared_ptr<const CornerTable> corner_;
  std::vector<std::vector<Near>> near_;  // by chunks of particles, ascending
  std::vector<Point<Real>> contributions_;
  struct Nearest {
    std::int32_t facet = -1;
    double distance = 0;
  };
  std::vector<Nearest> nearest_;  // facet of each particle, where there are any
  YieldingBodies<Real> bodies_;
  std::vector<Symmetric<Real>> moments_;
};

template <class Real>
template <class Visit>
void Boundary<Real>::for_near(std::span<const Point<Real>> x, const Visit& visit,
                              int threads) const {
  parallel_chunks(
      static_cast<std::int64_t>(near_.size()),
      [&](std::int64_t k) {
        for (const Near& entry : near_[usize(k)]) {
          const bool wall = usize(entry.collider) < colliders().size();
          visit(entry.particle, entry.gradient,
                velocity_of(usize(entry.collider), xyz(x[usize(entry.particle)])),
                wall ? entry.collider : -1);
        }
      },
      threads);
}

extern template class Boundary<float>;
extern template class Boundary<double>;

}  // namespace substep::pbf
