#include "substep/mpm/packet_passes.h"
#include "substep/mpm/von_mises.h"

namespace substep::mpm {

template struct Passes<VonMises, float, 2>;
template struct Passes<VonMises, float, 3>;
template struct Passes<VonMises, double, 2>;
template struct Passes<VonMises, double, 3>;

}  // namespace substep::mpm
