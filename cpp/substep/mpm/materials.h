// The list of materials: a new one is a header of its own and a line here.
#pragma once

#include <variant>

#include "substep/mpm/fixed_corotated.h"
#include "substep/mpm/fluid.h"
#include "substep/mpm/herschel_bulkley.h"
#include "substep/mpm/neo_hookean.h"
#include "substep/mpm/sand.h"
#include "substep/mpm/snow.h"
#include "substep/mpm/von_mises.h"

namespace substep::mpm {

using AnyMaterial =
    std::variant<NeoHookean, FixedCorotated, Fluid, Snow, Sand, VonMises, HerschelBulkley>;

}  // namespace substep::mpm
