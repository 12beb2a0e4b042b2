// What a collider does to the velocity v of the material at its surface, relative to that of the
// surface; n is the outward normal.
#pragma once

namespace substep::mpm {

enum class Boundary {
  kSticky,   // v = 0
  kSlip,     // v.n = 0
  kSeparate  // v.n >= 0
};
// The last two rub by the collider's `friction`: the jump of v along the surface is at most
// friction times the jump of v.n from below 0, and no more than stops it (Coulomb; with impulses
// m dv on both sides it is Coulomb's law for the forces of the step).

}  // namespace substep::mpm
