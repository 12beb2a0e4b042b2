#include "substep/mpm/materials/von_mises.h"

#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<VonMises, float, 2>;
template struct Passes<VonMises, float, 3>;
template struct Passes<VonMises, double, 2>;
template struct Passes<VonMises, double, 3>;

}  // namespace substep::mpm
