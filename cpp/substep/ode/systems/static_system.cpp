#include "substep/ode/systems/static_system.h"

#include "substep/ode/explicit/rkc.h"
#include "substep/ode/explicit/runge_kutta.h"
#include "substep/ode/implicit/implicit.h"
#include "substep/ode/stepping/system.h"
#include "substep/ode/systems/pointer_system.h"

namespace substep::ode {

std::unique_ptr<Stepper> System::make_stepper(std::string_view method, const StepOptions& options) {
  if (method == kRkc2) return make_rkc2(*this, options);
  auto stepper = make_runge_kutta<Methods>(method, *this, options);
  if (!stepper) stepper = make_implicit(method, *this, options);
  if (!stepper) throw InputError("method: unknown name " + std::string(method));
  return stepper;
}

// Loops of few components pay when their length is known.
bool PointerSystem::fixed_steps(const FixedRun& run) {
  const auto f = [function = function_, p = parameters_](double t, double* y, double* dydt) {
    function(t, y, dydt, p);
  };
  switch (size_) {
    case 1:
      return run_fixed_by_name<1>(run, f);
    case 2:
      return run_fixed_by_name<2>(run, f);
    case 3:
      return run_fixed_by_name<3>(run, f);
    case 4:
      return run_fixed_by_name<4>(run, f);
    case 5:
      return run_fixed_by_name<5>(run, f);
    case 6:
      return run_fixed_by_name<6>(run, f);
    default:
      return false;
  }
}

}  // namespace substep::ode
