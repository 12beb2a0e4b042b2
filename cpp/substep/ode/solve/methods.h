// The methods of solve_ivp by name. An explicit one is a table of core/tableau.h; the others are
// steppers of their own, listed in methods.cpp.
#pragma once

#include <memory>
#include <string_view>
#include <vector>

#include "substep/ode/stepping/stepper.h"

namespace substep::ode {

enum class Family { explicit_table, implicit, stabilized };

struct Method {
  std::string_view name;
  Family family;
  int order;
  int error_order;  // the step is chosen by error^(-1 / (error_order + 1))
  bool doubling;    // has no estimate of its own
};

// In rising order of accuracy within each family.
const std::vector<Method>& methods();

}  // namespace substep::ode
