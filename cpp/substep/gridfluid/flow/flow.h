// A flow that fills its box: incompressible, on a staggered grid, with what it carries.
//
//   du/dt + (u grad) u = -grad p / rho + nu div grad u + f,  div u = 0,
//   dx/dt + u grad x = kappa div grad x  of each scalar,  f = -g sum beta (x - ambient)
// (Boussinesq: p is what is left of the pressure beside that of the fluid at rest.) A step predicts
// the velocities with the pressure of the step before, and corrects both by a projection: van Kan,
// "A second-order accurate pressure-correction scheme for viscous incompressible flow", 1986.
//
// Two fluids (options.smoke): rho is that of each place, f = (1 - rho_0 / rho) g with the density
// rho_0 of the options, and p is what is left of the pressure beside that of a fluid of rho_0 at
// rest. Densities move first, with the velocities of the step before, and velocities then with
// them, so that waves neither grow nor die by it (flow_density.cpp).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/flow/diffusion.h"
#include "substep/gridfluid/flow/extension.h"
#include "substep/gridfluid/flow/flow_options.h"
#include "substep/gridfluid/flow/flow_sides.h"
#include "substep/gridfluid/flow/semi_lagrangian.h"
#include "substep/gridfluid/flow/stress.h"
#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

template <class Real, int D>
class Flow {
 public:
  using Fields = std::array<AlignedBuffer<Real>, D>;

  Flow(const Layout<D>& layout, const Vec3& low, double dx, const Sides<D>& sides,
       std::vector<geometry::Collider> colliders, std::vector<FlowSource> sources,
       const FlowOptions& options);

  // Throws and changes nothing where it fails: ConvergenceError of the pressure, SolverError where
  // more flows into a closed region than out, NonFiniteError.
  void step(double dt);
  // Takes from the velocities what has a divergence, and sets the pressure to 0. InputError where
  // there is no fluid, or more flows into a closed box than out. The pressure of two fluids becomes
  // that of settle().
  void project();
  // Gives faces in walls and inflows what these say; to be called where velocities were written.
  void hold_sides();
  // Of two fluids whose densities or velocities are new: the pressure under their weight.
  void settle();

  FlowSums sums();
  FlowLimits limits() const;
  double longest_step() const;
  // Rows of numbers at points [m]: velocity, pressure [Pa], scalars.
  std::vector<double> sample(std::span<const Vec3> points);
  // Velocities in the middle of cells, D numbers for each [m/s].
  std::vector<double> centred() const;

  const Layout<D>& layout() const { return layout_; }
  std::span<Real> velocity(std::size_t a) { return span(velocity_[a]); }
  std::span<const Real> velocity(std::size_t a) const { return span(velocity_[a]); }
  std::span<Real> scalar(std::size_t k) { return span(scalars_[k]); }
  std::span<const Real> scalar(std::size_t k) const { return span(scalars_[k]); }
  // Over the density of the options [m^2/s^2].
  std::span<double> pressure() { return {pressure_.data(), pressure_.size()}; }
  std::span<const double> pressure() const { return {pressure_.data(), pressure_.size()}; }
  // As obstacles are now.
  std::vector<Cell> cells();

  std::vector<geometry::Collider> colliders;  // read before each step, and moved by it
  FlowOptions options;
  FlowReport report;
  double time = 0;  // [s]

 private:
  static std::span<Real> span(AlignedBuffer<Real>& x) { return {x.data(), x.size()}; }
  static std::span<const Real> span(const AlignedBuffer<Real>& x) { return {x.data(), x.size()}; }
  static Velocity<Real, D> spans(Fields& fields);

  void find_domain();
  void find_sources();
  void check_inflow() const;
  void check_regions(const SolveReport& got, double divergence, double dt) const;
  double total_divergence(const Fields& fields) const;
  void start(double dt);
  void hold(std::size_t a, std::span<Real> x) const;
  bool predicts() const;
  bool needs_pressure() const;
  void take_pressure(Fields& fields, Real factor);
  void take_pressure(std::size_t a, std::int64_t begin, std::int64_t end, Real factor,
                     std::span<Real> x) const;
  bool two_fluids() const { return options.smoke >= 0; }
  Real density_of(Real smoke) const;
  void find_density(std::span<const Real> smoke);
  void add_weight(std::size_t a, std::int64_t begin, std::int64_t end, Real factor,
                  std::span<Real> x) const;
  void add_stress(std::span<Real> x, std::size_t a, double k) const;
  void weigh();
  void add_given(Fields& fields, double dt);
  void find_passing(const Velocity<Real, D>& u);
  void move_central(double dt);
  void move_along_paths(double dt);
  void drive_sources(Fields& fields);
  void correct(double dt);
  Velocity<Real, D> carrying() { return spans(two_fluids() ? velocity_ : change_); }
  void carry_scalars(double dt);
  void carry_limited(std::size_t k, double dt);
  void carry_along_paths(std::size_t k, double dt);
  void check_velocity() const;
  void check_scalars() const;
  void refuse_wrong(const char* what, std::int64_t i) const;
  void push(double dt);
  void keep(double dt);
  double number(double coefficient, double dt) const { return coefficient * dt / (dx_ * dx_); }
  double implicit_part(double number) const;
  void diffuse(Diffusion<Real, D>& diffusion, double k, std::span<Real> x, std::span<Real> d,
               std::size_t of);
  void solve(Diffusion<Real, D>& diffusion, double k, std::span<Real> d, std::size_t of);
  double mass() const;

  Layout<D> layout_;
  Vec3 low_;
  double dx_;
  SideGhosts<Real, D> sides_;
  std::vector<FlowSource> sources_;
  Obstacles<Real, D> obstacles_;
  Projection<Real, D> projection_;
  std::vector<Diffusion<Real, D>> face_diffusion_;
  Diffusion<Real, D> cell_diffusion_;
  std::array<Extension<D>, D> into_faces_;
  Extension<D> into_cells_;
  Stress<Real, D> stress_;
  SemiLagrangian<Real, D> paths_;
  std::vector<std::array<double, geometry::Collider::kStateSize>> found_;
  bool found_any_ = false, has_fluid_ = true;
  struct SourcePlaces {
    std::vector<std::int64_t> cells;
    std::array<std::vector<std::int64_t>, D> faces;
  };
  std::vector<SourcePlaces> places_;

  // The state.
  Fields velocity_;
  std::vector<AlignedBuffer<Real>> scalars_;
  AlignedBuffer<double> pressure_;
  // Of a step: what it begins with (the state itself, or beside obstacles a copy), comes to,
  // changes by, and is given.
  Velocity<Real, D> start_;
  Fields held_, next_, change_, given_, passing_;
  std::vector<AlignedBuffer<Real>> start_scalars_, next_scalars_;
  AlignedBuffer<Real> rates_, density_;  // of two fluids, in parts of the options' density
  Vec3 fall_ = Vec3::Zero();             // gravity times dt [m/s]
  FlowReport new_report_;
};

extern template class Flow<float, 2>;
extern template class Flow<float, 3>;
extern template class Flow<double, 2>;
extern template class Flow<double, 3>;

}  // namespace substep::gridfluid
