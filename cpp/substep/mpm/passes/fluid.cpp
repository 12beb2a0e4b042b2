#include "substep/mpm/materials/fluid.h"

#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<Fluid, float, 2>;
template struct Passes<Fluid, float, 3>;
template struct Passes<Fluid, double, 2>;
template struct Passes<Fluid, double, 3>;

}  // namespace substep::mpm
