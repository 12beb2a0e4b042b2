// What a simulation by the material point method is told.
#pragma once

#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/materials/materials.h"
#include "substep/mpm/passes/settings.h"

namespace substep::mpm {

struct Options : Settings {
  std::vector<AnyMaterial> materials;
};

}  // namespace substep::mpm
