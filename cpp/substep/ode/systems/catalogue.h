// The compiled systems by name, for those who need none of their formulas.
#pragma once

#include <memory>
#include <span>
#include <string_view>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

// With its parameters in the order of its constructor. InputError: there is none of that name with
// so many parameters.
std::shared_ptr<System> make_system(std::string_view name, std::span<const double> parameters);

}  // namespace substep::ode
