#include "substep/mpm/materials/catalogue.h"

#include "substep/core/errors.h"
#include "substep/mpm/materials/materials.h"

namespace substep::mpm {

std::vector<MaterialFields> material_fields() {
  std::vector<MaterialFields> all;
  for_each_material([&]<class M>(std::type_identity<M>) {
    all.push_back({M::kName, M::kHasF, {M::kState.begin(), M::kState.end()}});
  });
  return all;
}

std::vector<AnyMaterial> make_materials(const std::vector<MaterialConstants>& given) {
  std::vector<AnyMaterial> materials;
  for (const MaterialConstants& one : given) {
    const std::size_t before = materials.size();
    for_each_material([&]<class M>(std::type_identity<M>) {
      if (one.kind != M::kName) return;
      materials.push_back(M::with([&](const char* name) { return one.values.at(name); }));
    });
    if (materials.size() == before) throw InputError("materials: there is no " + one.kind);
  }
  return materials;
}

}  // namespace substep::mpm
