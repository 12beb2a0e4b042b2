// A simulation of either precision (dynamics.h), for those who choose it when they run; its
// obstacles are shared with its owner.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/core/numbers.h"
#include "substep/core/simulation.h"
#include "substep/geometry/collider.h"
#include "substep/pbd/solver/options.h"
#include "substep/pbd/solver/recipes.h"

namespace substep::pbd {

class Body : public Simulation {
 public:
  using Ids = std::span<const std::int64_t>;
  using Rows = std::span<const Triple>;
  using Colliders = std::vector<std::shared_ptr<geometry::Collider>>;
  // As they are stored; see Dynamics::raw().
  struct Raw {
    Numbers positions, velocities, targets;
  };

  virtual std::unique_ptr<Body> copy(Colliders colliders) const = 0;
  // See multilevel.h. pairs: the ends of edges of these lengths; rest: positions.
  virtual void use_multilevel(std::span<const std::int32_t> pairs, std::span<const double> lengths,
                              Rows rest) = 0;
  virtual std::vector<std::int64_t> level_sizes() const = 0;  // none without

  // As in Dynamics. Colliders are read before a step, and moved by it. Rows are of 3 numbers.
  virtual int threads() const = 0;
  virtual void set_threads(int threads) = 0;
  virtual Triple origin() const = 0;
  virtual std::int64_t skipped() const = 0;
  virtual double last_substep() const = 0;
  virtual double elastic_energy() const = 0;

  virtual std::vector<double> forces() const = 0;
  virtual std::vector<double> targets() const = 0;
  virtual std::vector<std::uint8_t> pinned() const = 0;
  virtual void set_positions(Ids ids, Rows values) = 0;
  virtual void set_velocities(Ids ids, Rows values) = 0;
  virtual void set_forces(Rows values) = 0;
  virtual void set_targets(Rows values) = 0;
  virtual void set_pinned(std::span<const std::uint8_t> pinned) = 0;

  virtual Raw raw() const = 0;
  // InputError: numbers of the other precision; nothing has changed then.
  virtual void set_raw(const Raw& raw) = 0;

  virtual std::size_t groups() const = 0;
  virtual std::vector<double> values(std::size_t group) = 0;
  virtual std::vector<double> multipliers(std::size_t group) = 0;
  virtual std::vector<double> group_state(std::size_t group) = 0;
  virtual void set_group_state(std::size_t group, std::span<const double> state) = 0;
};

std::unique_ptr<Body> make_body(Precision precision, Body::Rows positions, Body::Rows velocities,
                                std::span<const double> masses,
                                std::span<const std::uint8_t> pinned,
                                std::span<const Recipe* const> groups, Body::Colliders colliders,
                                const Options& options);

}  // namespace substep::pbd
