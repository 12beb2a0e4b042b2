// The list of materials: a new one is a header of its own and a line here.
#pragma once

#include <variant>

#include "substep/mpm/fixed_corotated.h"
#include "substep/mpm/neo_hookean.h"
#include "substep/mpm/sand.h"
#include "substep/mpm/snow.h"

namespace substep::mpm {

using AnyMaterial = std::variant<NeoHookean, FixedCorotated, Snow, Sand>;

}  // namespace substep::mpm
