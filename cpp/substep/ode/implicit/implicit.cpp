#include "substep/ode/implicit/implicit.h"

namespace substep::ode {

std::unique_ptr<Stepper> make_implicit(std::string_view method, System& system,
                                       const StepOptions& options) {
  using Matrices = NewtonMatrices;
  if (method == ImplicitEuler::name) {
    return std::make_unique<ImplicitEulerStepper<System, Matrices>>(
        system, options, make_newton_matrices(system, options));
  }
  if (method == RadauIIA5::name) {
    return std::make_unique<Radau<System, Matrices>>(system, options,
                                                     make_newton_matrices(system, options));
  }
  return nullptr;
}

}  // namespace substep::ode
