// What a flow is told, and what it tells of its steps.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "substep/geometry/collider.h"

namespace substep::gridfluid {

using geometry::Vec3;

enum class FlowAdvection { kCentral, kMacCormack, kSemiLagrangian };

// What the flow carries: a temperature, smoke.
struct ScalarOptions {
  double diffusivity = 0;  // [m^2/s]
  double buoyancy = 0;     // of its difference to `ambient`, in parts of the gravity, upward
  double ambient = 0;      // what flows in where a side is open
};

// A region in which something is given.
struct FlowSource {
  geometry::Collider region;
  std::vector<std::optional<double>> held;  // of each scalar
  std::vector<double> rate;                 // of each scalar, what is added in it [1/s]
  std::optional<Vec3> velocity;             // [m/s]
};

struct FlowOptions {
  double density = 1;                // [kg/m^3]
  double viscosity = 0;              // kinematic [m^2/s]
  Vec3 gravity = Vec3::Zero();       // acts on what scalars make lighter or heavier [m/s^2]
  bool slip = false;                 // whether obstacles let the flow pass along them
  double vorticity_confinement = 0;  // [m/s]
  FlowAdvection advection = FlowAdvection::kCentral;
  std::vector<ScalarOptions> scalars;
  // The number of the scalar that tells two fluids apart: where it is 1 the density is another,
  // between 0 and 1 linear, and gravity acts on all of it. -1: the density is the same everywhere.
  int smoke = -1;
  double smoke_density = 1;  // [kg/m^3]
  double tolerance = 1e-4;   // of the pressure
  int max_iterations = 500;
  double viscosity_tolerance = 1e-5;
  int viscosity_iterations = 500;
  int threads = 0;
};

// Of the last step.
struct FlowReport {
  const char* solver = "";  // of the pressure: transform, multigrid or diagonal
  int iterations = 0;       // of the pressure
  double residual = 0;      // relative
  bool converged = true;
  int viscosity_iterations = 0;  // of all components and scalars
  bool viscosity_converged = true;
};

struct FlowSums {
  double kinetic = 0;            // [J]
  Vec3 momentum = Vec3::Zero();  // [N s]
  double divergence = 0;         // the largest of a cell [1/s]
  double speed = 0;              // the largest along an axis [m/s]
  std::vector<double> scalars;   // means over the cells with fluid
};

// What a step has to be shorter for.
struct FlowLimits {
  double courant = 0;       // the largest sum of the speeds along axes in a cell [m/s]
  double acceleration = 0;  // the largest by buoyancy [m/s^2]
  double longest = 0;       // step in which what diffuses keeps its mean to rounding [s]
};

}  // namespace substep::gridfluid
