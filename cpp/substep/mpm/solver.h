// The material point method: particles carry mass, velocity and deformation; each step passes them
// through a grid, where forces and obstacles act.
//
// Sulsky, Chen, Schreyer, "A particle method for history-dependent materials", 1994; Jiang et al.,
// "The material point method for simulating continuum materials", SIGGRAPH course, 2016; Hu et al.,
// "A moving least squares material point method", 2018 (MLS: the fused form).
//
// Between public calls the state is that of the particles alone; grids are scratch. All that reads
// or writes particles does so in ascending order of their ids; the order of storage is private.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/boundary.h"
#include "substep/mpm/materials.h"
#include "substep/mpm/particles.h"

namespace substep::mpm {

using geometry::Vec3;

enum class Transfer { kPic, kFlip, kApic };
enum class Form { kMls, kTextbook };  // gradients: C of the affine fit, or those of the spline
enum class Integrator { kExplicit, kImplicit };
enum class OnLargeStep { kRaise, kSubdivide };
enum class OnEscape { kRaise, kRemove, kClamp };

struct Options {
  double cell = 1;  // dx [m]
  int order = 2;    // of the B-spline: 1, 2, 3
  Transfer transfer = Transfer::kApic;
  Form form = Form::kMls;
  Integrator integrator = Integrator::kExplicit;
  double flip_rate = 0;  // share of PIC per unit time: alpha = exp(-flip_rate dt) [1/s]
  Vec3 gravity{0, 0, -9.81};
  double cfl = 0.5;       // of the elastic wave and of particle speed
  double largest = 1e-2;  // step where nothing limits it [s]
  double step = 0;        // of advance [s]; 0: the largest that the limits allow
  OnLargeStep on_large_step = OnLargeStep::kRaise;
  std::vector<AnyMaterial> materials;
  std::vector<Boundary> boundaries;           // one per collider
  std::optional<std::array<Vec3, 2>> bounds;  // lowest and highest corner, world [m]
  OnEscape on_escape = OnEscape::kRaise;
  int threads = 0;
};

// The largest step that the conditions allow [s], and which of them it is.
struct StepLimit {
  double dt = 0;
  const char* reason = "";  // "elastic wave", "viscosity", "particle speed", "nothing moves"
};

// Of the last call of step or advance.
struct Report {
  std::int64_t steps = 0, sorts = 0;
  std::int64_t subdivided = 0;  // steps that were shorter than asked for, or taken again
  double dt = 0;                // of the last step [s]
  const char* limit = "";       // what limited it: a reason of StepLimit, "given" or "end"
  std::int64_t removed = 0, clamped = 0;  // particles that left the bounds
};

// Sums over all particles. In 2D of a layer of 1 m.
struct Diagnostics {
  double mass = 0;                                 // [kg]
  double kinetic = 0, potential = 0, elastic = 0;  // [J]
  Vec3 momentum = Vec3::Zero();                    // [N s]
  Vec3 angular_momentum = Vec3::Zero();            // about 0, affine part included [N m s]
  double supplied = 0;  // energy that particles brought in and that forces and obstacles did [J]
  double dissipated() const { return supplied - kinetic - potential - elastic; }
};

// Particles in the order of storage, of all materials one after the other: what a checkpoint holds.
// The numbers of a particle: x (D, in cells from its arena's first node), V_0, the material's
// fields, v (D), C (D x D); rows of materials with fewer fields are shorter.
template <class Real>
struct StoredParticles {
  std::vector<std::int64_t> counts;  // of each material
  std::vector<std::int32_t> ids;     // (n)
  std::vector<std::int32_t> blocks;  // (n, D)
  std::vector<Real> values;          // rows one after the other
};
struct Clock {
  double time = 0, supplied = 0;
  double drift = 0;  // how far particles may have moved since they were sorted [cells]
  std::int64_t next_id = 0;
};

template <class Real, int D>
class Solver {
 public:
  Solver(Options options, std::vector<geometry::Collider> colliders);
  Solver(Solver&&) noexcept;
  ~Solver();

  // Particles at x [m] with v [m/s], of these materials and volumes at rest [m^3; in 2D m^2], in
  // their materials' state of rest; returns the first id. InputError: too far away for blocks to
  // be numbered, and nothing has changed.
  std::int64_t add(std::span<const Vec3> x, std::span<const Vec3> v,
                   std::span<const std::int32_t> material, std::span<const double> volume);
  void remove(std::span<const std::uint8_t> flags);  // in the order of ids, as all below
  // Takes out what lies inside; returns how many.
  std::int64_t absorb(const geometry::Collider& region);

  std::int64_t size() const;
  std::vector<std::int64_t> ids() const;
  std::vector<std::int32_t> materials() const;
  std::vector<double> positions() const;   // (n, D) [m]
  std::vector<double> velocities() const;  // (n, D) [m/s]
  std::vector<double> affine() const;      // C, (n, D, D) [1/s]
  std::vector<double> volumes() const;     // V_0, (n)
  // The numbers of the particles of one material, (m, kFields<D>): F (3D: row by row; 2D: xx xy yx
  // yy zz) where there is an F, then its own.
  std::vector<double> material_fields(int material) const;
  // Cauchy stress times J: Kirchhoff stress tau of the admissible state, (n, 6): xx yy zz xy xz yz.
  std::vector<double> stresses() const;
  std::vector<double> elastic_energies() const;  // (n) [J]

  void set_positions(std::span<const Vec3> x, std::span<const std::int64_t> places);
  void set_velocities(std::span<const Vec3> v, std::span<const std::int64_t> places);
  void set_affine(std::span<const double> C, std::span<const std::int64_t> places);  // (m, D, D)
  // Of particles of one material, counted among them.
  void set_material_fields(int material, std::span<const double> fields,
                           std::span<const std::int64_t> places);
  void set_volumes(std::span<const double> volumes, std::span<const std::int64_t> places);
  // External forces [N] of the next step, which uses them up.
  void set_forces(std::span<const Vec3> forces, std::span<const std::int64_t> places);

  // One step of dt (or several, where it is too large and on_large_step says so). Where it throws,
  // nothing has changed.
  void step(double dt);
  // As many steps as a duration needs. Where it throws, the state is that after the last good step,
  // which the exception numbers.
  void advance(double duration);
  StepLimit step_limit() const;

  Diagnostics diagnostics() const;
  const Report& report() const;
  const Options& options() const;
  std::vector<geometry::Collider>& colliders();  // to be set and read between steps
  void set_threads(int threads);

  Clock clock;  // time may be set between steps
  StoredParticles<Real> stored() const;
  // InputError if that is no such state; nothing has changed then.
  void restore(const Clock& at, const StoredParticles<Real>& particles);

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

extern template class Solver<float, 2>;
extern template class Solver<float, 3>;
extern template class Solver<double, 2>;
extern template class Solver<double, 3>;

}  // namespace substep::mpm
