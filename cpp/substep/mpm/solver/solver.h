// The material point method: particles carry mass, velocity and deformation; each step passes them
// through a grid, where forces and obstacles act.
//
// Sulsky, Chen, Schreyer, "A particle method for history-dependent materials", 1994; Jiang et al.,
// "The material point method for simulating continuum materials", SIGGRAPH course, 2016; Hu et al.,
// "A moving least squares material point method", 2018 (MLS: the fused form).
//
// Between public calls the state is that of the particles alone; grids are scratch. All that reads
// or writes particles does so in ascending order of their ids; the order of storage is private.
//
// Calls are whole or not at all: where one throws, whatever it is (memory, an interrupt, the
// numbers), the state is that before it, or for `advance` that after a whole step. A whole step
// ends with what came out of emitters and went into sinks.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "substep/geometry/particle_flow.h"
#include "substep/mpm/implicit/implicit.h"
#include "substep/mpm/particles/measures.h"
#include "substep/mpm/particles/places.h"
#include "substep/mpm/passes/grid_update.h"
#include "substep/mpm/passes/options.h"
#include "substep/mpm/passes/transfers.h"
#include "substep/mpm/solver/method.h"

namespace substep::mpm {

struct Scheme;

template <class Real, int D>
class Solver {
 public:
  Solver(Options options, std::vector<geometry::Collider> colliders,
         geometry::ParticleFlow flow = {});
  Solver(const Solver&) = delete;
  Solver& operator=(const Solver&) = delete;

  // Particles at x [m] with v [m/s], of these materials and volumes at rest [m^3; in 2D m^2], in
  // their materials' state of rest; returns the first id. InputError: too far away for blocks to
  // be numbered, and nothing has changed.
  std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v,
                   std::span<const std::int32_t> material, std::span<const double> volume);
  void remove(std::span<const std::uint8_t> flags);  // in the order of ids, as all below

  static constexpr int kAll = -1;  // instead of a material
  std::int64_t size(int material = kAll) const;
  std::vector<std::int64_t> ids() const;
  std::vector<std::int32_t> materials() const;
  std::vector<double> positions() const;   // (n, D) [m]
  std::vector<double> velocities() const;  // (n, D) [m/s]
  std::vector<double> affine() const;      // C, (n, D, D) [1/s]
  std::vector<double> volumes() const;     // V_0, (n)
  // The numbers of the particles of one material, (m, kFields<D>): F (3D: row by row; 2D: xx xy yx
  // yy zz) where there is an F, then its own.
  std::vector<double> material_fields(int material) const;
  int field_count(int material) const;
  // Kirchhoff stress tau of the admissible state [Pa], (n, 6): xx yy zz xy xz yz.
  std::vector<double> stresses() const;
  std::vector<double> elastic_energies() const;  // (n) [J]

  void set_positions(std::span<const Vec3> x, std::span<const std::int64_t> places);
  void set_velocities(std::span<const Vec3> v, std::span<const std::int64_t> places);
  void set_affine(std::span<const double> C, std::span<const std::int64_t> places);  // (m, D, D)
  // Of particles of one material, counted among them.
  void set_material_fields(int material, std::span<const double> fields,
                           std::span<const std::int64_t> places);
  // External forces [N] of the next step, which uses them up.
  void set_forces(std::span<const Vec3> forces, std::span<const std::int64_t> places);

  // One step of dt (or several, where it is too large and on_large_step says so). Where it throws,
  // nothing has changed.
  void step(double dt);
  // One step as large as the limits allow.
  void step_by_limit();
  // As many steps as it takes to `end`. Where it throws, the state is that after the last good
  // step, which the exception numbers.
  void advance(double end);
  // The leg that an advance to `end` begins with, and the next step of one, bit for bit. The first
  // one of a leg does not go on; nor does one after a change of the particles.
  Leg next_leg(double end) const;
  void advance_once(const Leg& leg, bool goes_on);
  StepLimit step_limit() const;

  Diagnostics diagnostics() const;
  const Report& report() const { return report_; }
  const Options& options() const { return options_; }
  std::vector<geometry::Collider>& colliders() { return grid_.colliders; }  // between steps
  int threads() const { return options_.threads; }
  void set_threads(int threads) { options_.threads = threads; }

  double time() const { return clock_.time; }
  void set_time(double time) { clock_.time = time; }
  // The state: a clock, and the particles of each material in the order of storage.
  Clock clock() const;
  std::vector<ParticleRows<Real, D>> rows() const;
  const std::vector<Vec3>& forces() const { return forces_; }  // in the order of ids, or none
  const geometry::ParticleFlow& flow() const { return flow_; }
  // InputError if that is no such state; nothing has changed then.
  void restore(const Clock& at, const std::vector<ParticleRows<Real, D>>& rows,
               const std::vector<Vec3>& forces, const geometry::ParticleFlow::Counts& counts);

 private:
  // A step that is to be taken.
  struct NextStep {
    double dt = 0, end = 0;  // [s], time after it
    double speed = 0;        // the largest at its nodes [m/s]
    double reach = 0;        // no particle moves further along an axis [cells]
    const char* limit = "";  // what limited it
    std::string refused;     // why it must not be taken
  };

  // What became of a step whose nodes were found.
  enum class Outcome { kGood, kTooFar, kBadNode, kNotConverged };
  struct Trial {
    Outcome outcome;
    NodeCheck nodes;
  };

  // Whole or not at all.
  struct Kept {
    Particles<Real, D> particles;
    GridUpdate<Real, D> grid;
    Clock clock;
    Report report;
    std::vector<Vec3> forces;
    geometry::ParticleFlow::Counts counts;
    bool near_bounds;
  };
  void keep_state();
  void put_back() noexcept;
  // change(), or nothing; within another change, what undoes that undoes it.
  template <class Change>
  void whole(const Change& change) {
    if (kept_) return change();
    keep_state();
    try {
      change();
    } catch (...) {
      put_back();
      throw;
    }
    kept_.reset();
    goes_on_ = false;
  }

  // Steps.
  enum class Steps { kAll, kNext, kOneAlone };  // of a leg; kOneAlone: as if the leg ended there
  void run(const Leg& leg, double given, Steps steps);
  void steps_until_rest(const Leg& leg, double given, Steps steps);
  bool ends(const Leg& leg, const NextStep& step, Steps steps) const {
    return flow_.any() && (steps == Steps::kOneAlone || step.end >= leg.stop);
  }
  void let_flow();
  std::int64_t absorb(const geometry::Collider& region);
  NextStep first_step(double end, double given);
  void reserve_run(const NextStep& step, double end);
  NextStep choose_first(double end, double given);
  std::optional<NextStep> following(const NextStep& step, const Leg& leg, double given, bool stop);
  Trial go_on(const NextStep& step, NextStep& after);
  NextStep choose(double now, double end, double given, const StepLimit& limit);
  StepLimit limit(double speed, double wave) const;  // [m/s], c^2 [m^2/s^2]
  StepLimit limit_now(double speed, double given);
  Trial begin_step(double dt);
  Trial solve(double dt);
  void end_step(double dt);
  // Whether steps are those of transfers.h, fused; else those of general.h.
  bool fast() const {
    return options_.order == 2 && is_affine(options_.transfer) && options_.form == Form::kMls &&
           options_.integrator == Integrator::kExplicit;
  }
  Scheme scheme() const;
  void sort_resting();
  void shrink(NextStep& step, const Trial& trial, double given);
  void shrink_implicit(NextStep& step, double given);
  void halve(NextStep& step, const char* reason);
  void make_room(const NextStep& step);
  void rest(const NextStep& step);
  void commit(const NextStep& step) noexcept;
  void return_to_good_step();
  template <class Work>
  auto or_recover(const NextStep& step, const Work& work);
  Trial judged(const NodeCheck& nodes) const;
  // How far particles may be from where they were sorted [cells].
  double room() const { return drift_limit(options_.order) - ParticleBoundary<Real, D>::kPush; }
  Trial update(double dt);
  double push(double dt);
  std::int32_t culprit(std::int64_t node) const;
  std::int32_t limiting(const std::string& limit) const;
  [[noreturn]] void raise_not_finite(std::int64_t node) const;
  [[noreturn]] void raise(const std::string& message, std::int32_t id) const;

  // Particles.
  void layout_changed();
  void set_layout(ParticleBoundary<Real, D>&& walls) noexcept;
  bool escapes(const Vec3& x) const;
  std::int32_t first_escaped() const;
  void hold_escaped();
  Places places_of_ids(int material = kAll) const;
  template <class Row>
  std::vector<double> column(std::size_t width, const Row& row, int material = kAll) const;
  template <class Change>
  void supply(const Change& change);
  auto given_of_ids(std::span<const std::int64_t> places, int material) const;
  template <class Write>
  void write(std::span<const std::int64_t> places, const Write& write, int material = kAll);
  void check_rows(const Clock& at, const std::vector<ParticleRows<Real, D>>& rows) const;
  void sort_again(std::vector<ParticleRows<Real, D>>& rows);
  Diagnostics sums() const;

  Clock clock_;
  Options options_;
  Particles<Real, D> particles_;
  GridUpdate<Real, D> grid_;
  ImplicitStep<Real, D> implicit_;
  Report report_;
  geometry::ParticleFlow flow_;
  std::optional<Kept> kept_;  // while something is on that must not end half-way: what was before
  std::vector<Vec3> forces_;  // [N], in the order of ids; empty: none
  double work_ = 0;           // of the forces, in the step to come [J]
  std::array<Vec3, 2> bounds_;
  bool near_bounds_ = false;  // whether a particle may leave them in the next step

  // Scratch of a run of steps. `before_` is general.h's. `base_` holds the velocities of the first
  // step since the particles were at rest or sorted, `good_` the steps since then: from these the
  // state after them can be reached again.
  Nodes<Real, D> nodes_, next_, base_, before_;
  std::vector<geometry::Exchange> given_;  // of each collider, before the step at hand
  struct Begin {
    GridUpdate<Real, D> grid;
    Clock clock;
    Report report;
  };
  std::vector<Begin> begin_;  // of the first of `good_`; one or none
  std::vector<NextStep> good_;
  static constexpr std::int64_t kWaveSteps = 16;  // between two looks at c
  double wave_ = 0;                               // c^2 of the elastic wave [m^2/s^2]
  std::int64_t wave_age_ = 0;                     // steps since it was measured
  int shrinks_ = 0;                               // of the step that is being tried
  bool goes_on_ = false;  // whether the next step has this limit, as if fused with the last
  StepLimit next_limit_;
};

}  // namespace substep::mpm
