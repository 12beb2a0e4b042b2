#include "substep/mpm/materials/sand.h"

#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<Sand, float, 2>;
template struct Passes<Sand, float, 3>;
template struct Passes<Sand, double, 2>;
template struct Passes<Sand, double, 3>;

}  // namespace substep::mpm
