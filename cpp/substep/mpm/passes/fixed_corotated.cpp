#include "substep/mpm/materials/fixed_corotated.h"

#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<FixedCorotated, float, 2>;
template struct Passes<FixedCorotated, float, 3>;
template struct Passes<FixedCorotated, double, 2>;
template struct Passes<FixedCorotated, double, 3>;

}  // namespace substep::mpm
