#include "substep/mpm/materials/neo_hookean.h"

#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<NeoHookean, float, 2>;
template struct Passes<NeoHookean, float, 3>;
template struct Passes<NeoHookean, double, 2>;
template struct Passes<NeoHookean, double, 3>;

}  // namespace substep::mpm
