// The list of materials: a new one is a header of its own and a line here.
#pragma once

#include <variant>
#include <vector>

#include "substep/mpm/materials/catalogue.h"
#include "substep/mpm/materials/fixed_corotated.h"
#include "substep/mpm/materials/fluid.h"
#include "substep/mpm/materials/herschel_bulkley.h"
#include "substep/mpm/materials/neo_hookean.h"
#include "substep/mpm/materials/sand.h"
#include "substep/mpm/materials/snow.h"
#include "substep/mpm/materials/von_mises.h"

namespace substep::mpm {

using AnyMaterial =
    std::variant<NeoHookean, FixedCorotated, Fluid, Snow, Sand, VonMises, HerschelBulkley>;

// InputError: there is no such kind.
std::vector<AnyMaterial> make_materials(const std::vector<MaterialConstants>& given);

}  // namespace substep::mpm
