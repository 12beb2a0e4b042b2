// How contacts are solved (contact_solver.h).
#pragma once

#include "substep/rigid/motion/free_rotation.h"

namespace substep::rigid {

struct ContactOptions {
  int substeps = 8;
  int sweeps = 2;           // of the velocities in a sub-step
  double correction = 0.5;  // beta, of a sub-step
  double slop = 1e-4;       // overlap that is left, so that contacts last [m]
  double push_speed = 3.0;  // most that overlapping bodies are moved apart [m/s]
  double settling = 10.0;  // rate at which bodies that stand lose what little speed they have [1/s]
  FreeRotation rotation = FreeRotation::kSplitting;
};

}  // namespace substep::rigid
