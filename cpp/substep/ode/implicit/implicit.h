// The implicit steppers by name.
#pragma once

#include <memory>
#include <string_view>

#include "substep/ode/implicit/implicit_euler.h"
#include "substep/ode/implicit/radau.h"

namespace substep::ode {

// For any system; none for other names.
std::unique_ptr<Stepper> make_implicit(std::string_view method, System& system,
                                       const StepOptions& options);

// For a small system with a Jacobian of its own, inlined into the stepper; none where the options
// ask for more than it has.
template <class Sys>
std::unique_ptr<Stepper> make_static_implicit(std::string_view method, Sys& system,
                                              const StepOptions& options) {
  if (options.jacobian || options.mass || options.linear_solver == LinearSolver::krylov) {
    return nullptr;
  }
  using Matrices = StaticNewtonMatrices<Sys>;
  auto matrices = std::make_unique<Matrices>(system);
  if (method == ImplicitEuler::name) {
    return std::make_unique<ImplicitEulerStepper<Sys, Matrices>>(system, options,
                                                                 std::move(matrices));
  }
  if (method == RadauIIA5::name) {
    return std::make_unique<Radau<Sys, Matrices>>(system, options, std::move(matrices));
  }
  return nullptr;
}

}  // namespace substep::ode
