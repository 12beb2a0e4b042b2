#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<double, 3>;

}  // namespace substep::mpm
