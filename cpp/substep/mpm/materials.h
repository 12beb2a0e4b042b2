// The list of materials: a new one is a header of its own and a line here.
#pragma once

#include <variant>

#include "substep/mpm/neo_hookean.h"

namespace substep::mpm {

using AnyMaterial = std::variant<NeoHookean>;

}  // namespace substep::mpm
