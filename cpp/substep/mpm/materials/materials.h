// The list of materials: a new one is a header of its own, its name here, and a documented class in
// Python. The passes, the solver and the shared tests read the list.
#pragma once

#include <type_traits>
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

// visit(std::type_identity<M>()) of every material M.
template <class Visit, class... Materials>
void for_each_material(const Visit& visit, std::type_identity<std::variant<Materials...>>) {
  (visit(std::type_identity<Materials>()), ...);
}
template <class Visit>
void for_each_material(const Visit& visit) {
  for_each_material(visit, std::type_identity<AnyMaterial>());
}

// InputError: there is no such kind.
std::vector<AnyMaterial> make_materials(const std::vector<MaterialConstants>& given);

}  // namespace substep::mpm
