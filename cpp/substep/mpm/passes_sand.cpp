#include "substep/mpm/packet_passes.h"
#include "substep/mpm/sand.h"

namespace substep::mpm {

template struct Passes<Sand, float, 2>;
template struct Passes<Sand, float, 3>;
template struct Passes<Sand, double, 2>;
template struct Passes<Sand, double, 3>;

}  // namespace substep::mpm
