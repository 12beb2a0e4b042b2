// What a fluid is told, and what it tells of its steps.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "substep/geometry/vectors.h"

namespace substep::pbf {

using geometry::Vec3;

enum class Kernel { kCubicSpline, kPoly6Spiky };

struct DensityOptions {
  Kernel kernel = Kernel::kCubicSpline;
  int dimension = 3;
  double spacing = 1;              // of the rest lattice [m]
  double support = 2;              // h / spacing
  double relaxation = 0;           // e
  double artificial_pressure = 0;  // k
  bool one_sided = true;
};

struct ForceOptions {
  double xsph = 0;                // 0 to 1
  std::vector<double> viscosity;  // of each fluid [m^2/s]; empty: none
  double viscosity_tolerance = 1e-3;
  int viscosity_iterations = 200;
  double vorticity_confinement = 0;  // [m/s]
  double surface_tension = 0;        // [N/m]

  bool any_on_velocities() const {
    return xsph > 0 || !viscosity.empty() || vorticity_confinement > 0;
  }
};

enum class OnEscape { kRaise, kRemove, kClamp };

struct FluidOptions {
  DensityOptions density;
  ForceOptions forces;
  std::vector<double> masses;  // of a particle of each fluid [kg]
  Vec3 gravity = {0, 0, -9.81};
  double tolerance = 1e-3;   // of the mean density error
  double max_tolerance = 1;  // of the largest one
  int min_iterations = 2, max_iterations = 5;
  bool divergence_free = false;        // velocities by a pressure of their own, not from positions
  double divergence_tolerance = 1e-4;  // mean of what is compressed in a step
  int divergence_iterations = 100;
  double warm_start = 0;  // share of the last step's multipliers that the next begins with
  OnEscape on_escape = OnEscape::kRaise;
  std::optional<std::array<Vec3, 2>> bounds;  // lowest and highest corner, world [m]
  int threads = 0;
};

// Of max(C, 0), or |C| where the constraint is not one-sided.
struct DensityError {
  double mean = 0, max = 0;
};

struct ViscosityReport {
  int iterations = 0;
  double residual = 0;  // |M (v - v_old) - dt F(v)| / |dt F(v_old)|, in the norm of M^-1
  bool converged = true;
};

struct ProjectionReport {
  int iterations = 0;
  double error = 0;  // mean of what velocities would compress in the step
  bool converged = true;
};

// Of the last step.
struct FluidReport {
  int iterations = 0;
  bool converged = true;
  DensityError density_error;  // before the last correction, if there was one
  std::int64_t limited = 0;    // corrections that reached the limit
  ViscosityReport viscosity;
  ProjectionReport projection;
  std::int64_t removed = 0, clamped = 0;  // particles that left the bounds
};

struct Energies {
  double kinetic = 0, potential = 0;                              // [J]
  Vec3 momentum = Vec3::Zero(), angular_momentum = Vec3::Zero();  // the latter about 0

  void operator+=(const Energies& other) {
    kinetic += other.kinetic;
    potential += other.potential;
    momentum += other.momentum;
    angular_momentum += other.angular_momentum;
  }
};

}  // namespace substep::pbf
