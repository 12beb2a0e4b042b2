// A simulation of either precision in two or three dimensions (solver.h), for those who choose when
// they run; its obstacles are shared with its owner.
#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/core/numbers.h"
#include "substep/core/simulation.h"
#include "substep/geometry/collider.h"
#include "substep/geometry/particle_flow.h"
#include "substep/mpm/materials/catalogue.h"
#include "substep/mpm/particles/diagnostics.h"
#include "substep/mpm/passes/settings.h"

namespace substep::mpm {

// A part of an advance, to the next time at which emitters and sinks are asked. Steps go to `stop`,
// which is `end` but for rounding; then the time is `end`.
struct Leg {
  double stop = 0, end = 0;  // [s]
};

// What a state holds besides particles.
struct Clock {
  double time = 0;      // [s]
  double supplied = 0;  // energy that particles brought in and that forces and obstacles did [J]
  double drift = 0;     // how far particles may have moved since they were sorted [cells]
  std::int64_t next_id = 0;
  bool trial = true;  // the return map of the last step is still to come
  double before = 0;  // dt of that step [s]

  // Energy from outside [J]; what is beyond all numbers is not counted.
  void supply(double energy) {
    if (std::isfinite(supplied + energy)) supplied += energy;
  }
};

// Particles one material after the other, in the order of storage.
struct MethodState {
  Clock clock;
  std::vector<std::int64_t> counts;  // of each material
  std::vector<std::int32_t> ids, blocks;
  Numbers values, motion, volumes;  // values: x, then the numbers of the material
  std::vector<Vec3> forces;         // in the order of ids, or none
  geometry::ParticleFlow::Counts flow;
};

class Method : public Simulation {
 public:
  using Places = std::span<const std::int64_t>;  // in the order of ids

  // As in Solver, whose obstacles are the owner's: read before steps, and moved by them, also by
  // those before one that failed.
  virtual std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v,
                           std::span<const std::int32_t> material,
                           std::span<const double> volume) = 0;
  virtual void remove(Places places) = 0;
  virtual StepLimit step_limit() const = 0;

  virtual int dimension() const = 0;
  int columns() const final { return dimension(); }
  virtual std::int64_t size() const = 0;
  virtual std::vector<std::int64_t> ids() const = 0;
  virtual std::vector<std::int32_t> materials() const = 0;
  virtual std::vector<double> affine() const = 0;
  virtual std::vector<double> volumes() const = 0;
  virtual std::vector<double> stresses() const = 0;
  virtual std::vector<double> elastic_energies() const = 0;
  virtual std::vector<double> material_fields(int material) const = 0;
  virtual int field_count(int material) const = 0;
  virtual void set_positions(std::span<const Vec3> x, Places places) = 0;
  virtual void set_velocities(std::span<const Vec3> v, Places places) = 0;
  virtual void set_forces(std::span<const Vec3> forces, Places places) = 0;
  virtual void set_affine(std::span<const double> C, Places places) = 0;
  virtual void set_material_fields(int material, std::span<const double> fields, Places places) = 0;

  virtual int threads() const = 0;
  virtual void set_threads(int threads) = 0;
  virtual Report report() const = 0;
  virtual Diagnostics diagnostics() const = 0;
  virtual const geometry::ParticleFlow::Counts& counts() const = 0;

  virtual MethodState state() const = 0;
  // InputError: it is no such state, or numbers of the other precision; nothing has changed then.
  virtual void restore(const MethodState& state) = 0;
};

std::unique_ptr<Method> make_method(Precision precision, int dimension, const Settings& settings,
                                    const std::vector<MaterialConstants>& materials,
                                    std::vector<std::shared_ptr<geometry::Collider>> colliders,
                                    geometry::ParticleFlow flow = {});

}  // namespace substep::mpm
