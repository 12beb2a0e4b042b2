// Position-based dynamics: particles that are predicted, projected onto constraints, and take their
// velocities from where they came to (Mueller et al. 2007, algorithm 1, in substeps as Macklin et
// al. 2019, "Small steps in physics simulation").
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/particle_contact.h"
#include "substep/pbd/contact/body_contact.h"
#include "substep/pbd/groups/group.h"
#include "substep/pbd/solver/options.h"
#include "substep/pbd/solver/projector.h"

namespace substep::pbd {

// All arrays of one row per particle are in the order of their ids; positions are in the world.
template <class Real>
class Dynamics {
 public:
  Dynamics(std::span<const Triple> positions, std::span<const Triple> velocities,
           std::span<const double> masses, std::span<const std::uint8_t> pinned,
           std::vector<std::unique_ptr<Group<Real>>> groups,
           std::vector<geometry::Collider> colliders, const Options& options);
  Dynamics(const Dynamics& other);

  // One step, in substeps, or all as it was and an exception.
  void step(double dt);

  std::int64_t size() const { return count_; }
  const Triple& origin() const { return origin_; }
  const Partition& partition() const { return partition_; }
  Group<Real>& group(std::size_t k) { return *groups_[k]; }
  std::size_t groups() const { return groups_.size(); }

  void positions(std::span<Triple> out) const;
  void velocities(std::span<Triple> out) const;
  void set_positions(std::span<const std::int64_t> ids, std::span<const Triple> values);
  void set_velocities(std::span<const std::int64_t> ids, std::span<const Triple> values);
  // External forces [N] of the next step; none if empty.
  void set_forces(std::span<const Triple> values);
  void forces(std::span<Triple> out) const;
  // Where pinned particles go in the next step, in a straight line: one row for each particle, or
  // none: they stay.
  void set_targets(std::span<const Triple> values);
  void targets(std::span<Triple> out) const;
  void set_pinned(std::span<const std::uint8_t> pinned);
  std::vector<std::uint8_t> pinned() const;

  // As they are stored, positions and targets relative to the origin: for checkpoints. There are
  // targets if they were set since the particles were made.
  bool has_targets() const { return !target_.empty(); }
  void raw(std::span<Real> positions, std::span<Real> velocities, std::span<Real> targets) const;
  void set_raw(std::span<const Real> positions, std::span<const Real> velocities,
               std::span<const Real> targets);

  void values(std::size_t group, std::span<double> c) const;
  void multipliers(std::size_t group, std::span<double> lambda) const;
  double elastic_energy() const;  // [J]
  // Constraints that the last step skipped because their gradients vanish, in all its projections.
  std::int64_t skipped() const { return skipped_; }
  double last_substep() const { return last_h_; }

  Options options;
  double time = 0;
  std::unique_ptr<Projector<Real>> projector;  // begins each iteration, where there is one
  std::optional<geometry::ParticleContact<Real>> contact;  // where there are colliders

 private:
  enum Work : std::uint8_t { kFinish = 1, kPredict = 2, kProject = 4 };
  enum class Kind : std::uint8_t { patches, group, corrections, gather };
  // One loop over chunks that share nothing; a step is a list of these.
  struct Phase {
    Kind kind;
    std::uint8_t work = 0;  // of Kind::patches, in this order
    std::size_t group = 0;
    int group_phase = 0;
    int substep = 0, iteration = 0;
    std::int64_t chunks = 0;
  };

  void run_step();
  void run_substep(int substep, std::uint8_t& pending);
  void sweep_groups(int substep, int iteration);
  void correct_groups(int substep, int iteration);
  void run(const Phase& phase);  // after those that wait
  void later(Phase phase);       // with the next ones, in one parallel loop
  void flush();
  void work(const Phase& phase, std::int64_t chunk);
  void work_on_patch(const Phase& phase, std::int64_t patch);
  void predict(std::int64_t patch, std::int64_t begin, std::int64_t end, int substep);
  void finish(std::int64_t begin, std::int64_t end, int substep);
  void gather(std::int64_t begin, std::int64_t end);
  void end_pins();
  void save(std::int64_t patch);
  void restore_saved();
  void prepare_jacobi();
  Sweep<Real> sweep(int substep, int iteration) const;
  std::size_t row(std::int64_t id) const { return usize(partition_.slot[usize(id)]); }
  Point<Real> relative(const Triple& x) const;

  std::int64_t count_;
  Triple origin_;
  Partition partition_;
  std::vector<Point<Real>> x_, x_old_;       // w: inverse mass, 0 where pinned; an empty row more
  std::vector<Point<Real>> v_;               // w: inverse mass
  std::vector<Point<Real>> force_, target_;  // empty where there are none
  std::vector<Point<Real>> saved_x_, saved_v_;
  std::vector<std::uint8_t> saved_;  // patches
  BodyContact<Real> bodies_;         // where obstacles yield
  std::vector<Real> contact_mass_;   // of each slot, 0 where pinned; where there are colliders
  std::vector<Point<Real>> v_old_;   // at the start of the substep; the same
  std::vector<std::unique_ptr<Group<Real>>> groups_;

  std::vector<std::size_t> correction_start_;  // of each group, in corrections_; Jacobi
  std::vector<Point<Real>> corrections_;
  std::vector<std::int64_t> held_start_;  // corrections of each slot
  std::vector<std::int64_t> held_;
  std::vector<std::int32_t> splits_;

  std::vector<Phase> phases_;
  double dt_ = 0, h_ = 0, last_h_ = 0;
  std::atomic<std::int64_t> skips_{0};
  std::int64_t skipped_ = 0;
};

}  // namespace substep::pbd
