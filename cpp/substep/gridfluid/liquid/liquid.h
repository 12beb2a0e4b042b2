// A liquid of particles on a grid, of either precision and dimension, for those who choose it when
// they run: rows by ascending id, in the places that its owner knows, and obstacles that its owner
// shares.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/core/numbers.h"
#include "substep/core/simulation.h"
#include "substep/geometry/collider.h"
#include "substep/geometry/particle_flow.h"
#include "substep/gridfluid/particles/move.h"

namespace substep::gridfluid {

using geometry::Vec3;

struct LiquidOptions {
  int dimension = 3;
  std::array<int, 3> cells{};  // along each axis; 2D: the first two
  Vec3 low = Vec3::Zero();     // lowest corner of the grid [m]
  double cell = 1;             // [m]
  // The lower and the upper side of each axis: whether the liquid may leave there, and axes where
  // it comes in again on the other side.
  std::array<std::array<bool, 2>, 3> open{};
  std::array<bool, 3> periodic{};
  double density = 1000;  // [kg/m^3]
  Vec3 gravity = {0, 0, -9.81};
  Transfer transfer = Transfer::kApic;
  double flip_rate = 1;        // of FLIP; the rest is PIC
  double viscosity = 0;        // kinematic [m^2/s]
  double surface_tension = 0;  // [N/m]
  bool slip = false;           // whether it passes along walls and obstacles in spite of it
  double viscosity_tolerance = 1e-4;
  int viscosity_iterations = 300;
  double tolerance = 1e-4;
  int max_iterations = 100;
  bool keep_volume = true;
  int narrow_band = 0;  // cells below the surface that particles fill; 0: all
  int threads = 0;
};

// Of the last step.
struct LiquidReport {
  int iterations = 0;   // of the pressure
  double residual = 0;  // relative
  bool converged = true;
  int viscosity_iterations = 0;
  bool viscosity_converged = true;
  int volume_iterations = 0;  // of the correction of the density
  double mean_error = 0;      // before it: of the density, mean over the cells inside
  std::int64_t removed = 0;   // particles that left by an open side
};

struct LiquidEnergies {
  double kinetic = 0, potential = 0;                              // [J]
  Vec3 momentum = Vec3::Zero(), angular_momentum = Vec3::Zero();  // the latter about 0

  void operator+=(const LiquidEnergies& other) {
    kinetic += other.kinetic;
    potential += other.potential;
    momentum += other.momentum;
    angular_momentum += other.angular_momentum;
  }
};

// In the order of storage.
struct LiquidState {
  double time = 0, last_dt = 0;  // [s]
  std::int64_t next_id = 0;
  Numbers positions;              // (n, dimension), in cells from the lowest corner
  Numbers velocities;             // (n, dimension) [m/s]
  Numbers affine;                 // (n, dimension^2) [1/s]; empty but for APIC
  Numbers forces;                 // (n, dimension) [N]; empty where there are none
  std::vector<std::int64_t> ids;  // (n)
  std::vector<double> pressure;   // of the cells [m/s], times dt / (density cell)
  // Of a narrow band, else empty: flags of the cells, velocities of the faces along each axis in
  // turn [m/s], and how many cells were filled with particles.
  std::vector<std::uint8_t> deep{};
  Numbers deep_velocity{};
  std::int64_t seeded = 0, missing = 0;
  geometry::ParticleFlow::Counts flow;
};

class Liquid : public Simulation {
 public:
  using Places = std::span<const std::int64_t>;  // in the order of ids

  // Returns the id of the first. InputError: a point outside of the box.
  virtual std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v) = 0;
  virtual void remove(Places places) = 0;

  virtual std::int64_t size() const = 0;
  virtual std::int64_t deep_cells() const = 0;  // of a narrow band: full, without particles
  virtual int dimension() const = 0;
  int columns() const final { return dimension(); }
  virtual std::vector<std::int64_t> ids() const = 0;
  virtual void set_positions(std::span<const Vec3> x, Places places) = 0;
  virtual void set_velocities(std::span<const Vec3> v, Places places) = 0;
  virtual void set_forces(std::span<const Vec3> f, Places places) = 0;

  virtual int threads() const = 0;
  virtual void set_threads(int threads) = 0;
  virtual LiquidReport report() const = 0;
  virtual LiquidEnergies energies() const = 0;
  virtual double fastest() const = 0;  // largest component of a velocity [m/s]
  virtual const geometry::ParticleFlow::Counts& counts() const = 0;

  // Of the cells, in rows along the last axis.
  virtual std::vector<double> pressure() const = 0;  // [Pa]
  virtual std::vector<double> level_set() = 0;       // distance to the surface [m], below 0 inside
  virtual std::vector<double> grid_velocity() = 0;   // (cells, dimension) [m/s]

  virtual LiquidState state() const = 0;
  // InputError: numbers of the other precision, or other emitters; nothing has changed then.
  virtual void restore(const LiquidState& state) = 0;
};

// The colliders are read before each step, and moved by it.
std::unique_ptr<Liquid> make_liquid(Precision precision,
                                    std::vector<std::shared_ptr<geometry::Collider>> colliders,
                                    const LiquidOptions& options, geometry::ParticleFlow flow = {});

}  // namespace substep::gridfluid
