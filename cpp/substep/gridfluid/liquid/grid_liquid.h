// A liquid with a free surface in time: particles carry the velocity, the grid makes it free of
// divergence (Zhu and Bridson, "Animating sand as a fluid", 2005; Jiang et al., "The affine
// particle-in-cell method", 2015).
//
// Velocities change first, where the particles are; then they move: as a step of symplectic Euler.
// Afterwards a second pressure, which changes positions alone, sets right how many particles full
// cells hold (Kugelstadt et al., "Implicit density projection for volume conserving liquids",
// 2021).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/geometry/particle_flow.h"
#include "substep/gridfluid/liquid/liquid.h"
#include "substep/gridfluid/liquid/narrow_band.h"
#include "substep/gridfluid/particles/extrapolate.h"
#include "substep/gridfluid/particles/particles.h"
#include "substep/gridfluid/particles/surface.h"
#include "substep/gridfluid/pressure/obstacles.h"
#include "substep/gridfluid/pressure/projection.h"
#include "substep/gridfluid/pressure/surface_tension.h"
#include "substep/gridfluid/viscosity/viscosity.h"

namespace substep::gridfluid {

template <class Real, int D>
class GridLiquid {
 public:
  GridLiquid(std::vector<geometry::Collider> colliders, const LiquidOptions& options,
             geometry::ParticleFlow flow = {});

  // Puts particles at the end; returns the id of the first. InputError: one is not in the box.
  std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v);
  void remove(std::span<const std::uint8_t> flags);  // by row
  bool is_inside(const Vec3& x) const;
  void check_inside(std::span<const Vec3> x) const;

  // One step, with what comes out of emitters and goes into sinks at its end, or an exception and
  // nothing has changed.
  void step(double dt);
  // Keeps the present state, and goes back to it, once, from what steps alone have made of it.
  void keep();
  void rewind();

  LiquidEnergies energies() const;
  double fastest() const;    // largest component of a velocity [m/s]
  double mass() const;       // of a particle [kg]
  double cell_mass() const;  // of the liquid in a full cell [kg]
  Vec3 position(std::int64_t row) const;
  Vec3 velocity(std::int64_t row) const;
  void set_position(std::int64_t row, const Vec3& x);
  void set_velocity(std::int64_t row, const Vec3& v);
  // Of the cells, in rows along the last axis.
  std::vector<double> pressure() const;
  std::vector<double> level_set();
  std::vector<double> grid_velocity();

  LiquidOptions options;
  Layout<D> layout;
  Obstacles<Real, D> obstacles;
  Particles<Real, D> particles;
  std::vector<std::array<Real, D>> forces;  // on each [N], of the next step; empty: none
  geometry::ParticleFlow flow;
  LiquidReport report;
  double time = 0;
  double last_dt = 0;  // 0 before the first step
  std::int64_t next_id = 0;
  AlignedBuffer<double> q;  // pressure of the last step, times dt / (density cell) [m/s]
  std::optional<NarrowBand<Real, D>> band;

 private:
  static constexpr double kMargin = 1e-3;  // that particles keep from sides and obstacles [cells]

  using Field = AlignedBuffer<Real>;
  using Fields = std::array<Field, D>;

  struct Kept {
    bool stepped = false;  // since; before, the particles are still the present ones
    Particles<Real, D> particles;
    std::vector<std::array<Real, D>> forces;
    geometry::ParticleFlow::Counts counts;
    LiquidReport report;
    double time, last_dt;
    std::int64_t next_id;
    AlignedBuffer<double> q;
    std::optional<NarrowBand<Real, D>> band;
  };

  void append(Particles<Real, D>& to, std::int64_t first_id, std::span<const Vec3> x,
              std::span<const Vec3> v) const;
  void sort(double dt);
  void accelerate_bodies(double dt);
  void push_bodies_before(double dt);
  std::span<const double> find_first_pressure(double dt);
  void find_surface();
  void count_obstacles_in();
  void extend_surface();
  void pass_to_grid();
  void accelerate(double dt);
  void pull_surface(double dt);
  void project(double dt);
  void make_incompressible(double guess);
  void change_around();
  void make_viscous(double dt);
  void hold_nozzles();
  void push_obstacles(double dt);
  void push_bodies();
  void reset_bodies();
  void find_valid();
  void find_displacement();
  void move_obstacles(double dt);
  void find_deep(double dt);
  int reach_of_deep(double dt) const;
  std::int64_t move(Particles<Real, D>& which, Transfer transfer, double dt);
  void move_particles(double dt);
  void change_band(double dt);
  std::vector<std::uint8_t> in_deep(const Particles<Real, D>& of) const;
  void let_flow(double end);
  std::int64_t drop(const std::vector<std::uint8_t>& flags);
  LiquidEnergies energies_of_deep() const;
  std::int64_t leave_by_open_sides();
  std::int64_t absorb(const geometry::Collider& region);
  void commit(double dt) noexcept;

  Vec3 position(const Particles<Real, D>& of, std::int64_t row) const;
  Vec3 middle(std::int64_t cell) const;  // [m]
  std::int64_t cell_at(const Vec3& x) const;
  template <class Each>
  void for_walls(const Each& each) const;
  void fill_around(Fields& u, int layers);
  static ConstFaces<Real, D> const_faces(const Fields& fields);
  static Faces<Real, D> faces(Fields& fields);
  static Velocity<Real, D> spans(Fields& fields);

  std::optional<Kept> kept_;
  // During a step: the particles in the order of their cells, and what they will be when it ends.
  Particles<Real, D> next_;
  geometry::ParticleFlow::Counts new_counts_;
  std::int64_t new_next_id_ = 0;
  LiquidReport new_report_;
  // Of the faces: velocities, those before forces and pressure, displacements, and what is above 0
  // where they are known, and with viscosity where particles are.
  Fields u_, old_u_, shift_, weight_, met_;
  Field phi_, density_, scratch_;  // of the cells
  int reach_ = 1;                  // cells that deep liquid moves by, rounded up
  Extrapolation<Real, D> extrapolate_;
  AlignedBuffer<double> new_q_;
  Projection<Real, D> projection_;
  SurfaceTension<Real, D> surface_tension_;
  Viscosity<Real, D> viscosity_;
  std::vector<geometry::Exchange> shear_;  // that colliders were given
  // Where any yield: the velocities of bodies of colliders before any pressure, and what those that
  // yield were given by pressures.
  std::vector<geometry::Vec6> free_motion_;
  std::vector<geometry::Exchange> given_;
};

extern template class GridLiquid<float, 2>;
extern template class GridLiquid<float, 3>;
extern template class GridLiquid<double, 2>;
extern template class GridLiquid<double, 3>;

}  // namespace substep::gridfluid
