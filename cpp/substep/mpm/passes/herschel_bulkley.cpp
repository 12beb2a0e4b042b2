#include "substep/mpm/materials/herschel_bulkley.h"

#include "substep/mpm/passes/packet_passes.h"

namespace substep::mpm {

template struct Passes<HerschelBulkley, float, 2>;
template struct Passes<HerschelBulkley, float, 3>;
template struct Passes<HerschelBulkley, double, 2>;
template struct Passes<HerschelBulkley, double, 3>;

}  // namespace substep::mpm
