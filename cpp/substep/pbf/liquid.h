// A fluid of either precision, for those who choose it when they run: rows by ascending id, in the
// places that its owner knows, and obstacles that its owner shares.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/core/numbers.h"
#include "substep/core/simulation.h"
#include "substep/geometry/collider.h"
#include "substep/geometry/particle_flow.h"
#include "substep/pbf/options.h"

namespace substep::pbf {

// In the order of storage; rows of four numbers (particles.h).
struct LiquidState {
  double time = 0, last_dt = 0;  // [s]
  std::int64_t next_id = 0;
  Numbers positions, velocities, forces;
  std::vector<std::int64_t> ids;
  std::vector<std::int32_t> fluids;
  geometry::ParticleFlow::Counts flow;
};

class Liquid : public Simulation {
 public:
  using Places = std::span<const std::int64_t>;  // in the order of ids

  // Returns the id of the first.
  virtual std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v,
                           std::span<const std::int32_t> fluid) = 0;
  virtual void remove(Places places) = 0;

  virtual std::int64_t size() const = 0;
  virtual int dimension() const = 0;
  int columns() const final { return dimension(); }
  virtual std::vector<std::int64_t> ids() const = 0;
  virtual std::vector<std::int32_t> fluids() const = 0;
  virtual std::vector<double> densities() = 0;  // (n), see Fluid::densities()
  virtual void set_positions(std::span<const Vec3> x, Places places) = 0;
  virtual void set_velocities(std::span<const Vec3> v, Places places) = 0;
  virtual void set_forces(std::span<const Vec3> f, Places places) = 0;

  virtual int threads() const = 0;
  virtual void set_threads(int threads) = 0;
  virtual FluidReport report() const = 0;
  virtual Energies energies() const = 0;
  virtual double fastest() const = 0;
  virtual double lone_density() const = 0;  // of a particle that has no neighbours
  virtual const geometry::ParticleFlow::Counts& counts() const = 0;

  virtual LiquidState state() const = 0;
  // InputError: numbers of the other precision, or other emitters; nothing has changed then.
  virtual void restore(const LiquidState& state) = 0;
};

// The colliders are read before each step, and moved by it.
std::unique_ptr<Liquid> make_liquid(Precision precision, const Vec3& origin,
                                    std::vector<std::shared_ptr<geometry::Collider>> colliders,
                                    const FluidOptions& options, geometry::ParticleFlow flow = {});

}  // namespace substep::pbf
