// What a simulation by the material point method is told besides its materials, and what it tells
// of its steps.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "substep/geometry/vectors.h"
#include "substep/mpm/boundary/boundary.h"

namespace substep::mpm {

using geometry::Vec3;

enum class Transfer { kPic, kFlip, kApic, kAflip };
// Whether particles pass on the affine part of their velocity, and what the grid does not see of
// it.
constexpr bool is_affine(Transfer t) { return t == Transfer::kApic || t == Transfer::kAflip; }
constexpr bool keeps_change(Transfer t) { return t == Transfer::kFlip || t == Transfer::kAflip; }
enum class Form { kMls, kTextbook };  // gradients: C of the affine fit, or those of the spline
enum class Integrator { kExplicit, kImplicit };
enum class OnLargeStep { kRaise, kSubdivide };
enum class OnEscape { kRaise, kRemove, kClamp };

struct Settings {
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
  std::int64_t newton = 0, krylov = 0;    // iterations of implicit steps, of all together
};

}  // namespace substep::mpm
