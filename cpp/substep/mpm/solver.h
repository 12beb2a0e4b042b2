// The material point method: particles carry mass, velocity and deformation; each step passes them
// through a grid, where forces and obstacles act.
//
// Sulsky, Chen, Schreyer, "A particle method for history-dependent materials", 1994; Jiang et al.,
// "The material point method for simulating continuum materials", SIGGRAPH course, 2016; Hu et al.,
// "A moving least squares material point method", 2018 (MLS: the fused form).
//
// Between calls of step() and advance() the state is that of the particles alone; grids are
// scratch.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/boundary.h"
#include "substep/mpm/materials.h"

namespace substep::mpm {

enum class Transfer { kPic, kFlip, kApic };
enum class Form { kMls, kTextbook };  // gradients: C of the affine fit, or those of the spline

struct Options {
  double cell = 1;  // dx [m]
  int order = 2;    // of the B-spline: 1, 2, 3
  Transfer transfer = Transfer::kApic;
  Form form = Form::kMls;
  double flip_rate = 0;  // share of PIC per unit time: alpha = exp(-flip_rate dt) [1/s]
  geometry::Vec3 gravity{0, 0, -9.81};
  double cfl = 0.5;  // of the elastic wave and of particle speed
  std::vector<AnyMaterial> materials;
  std::vector<Boundary> boundaries;  // one per collider
};

// What advance and step say: what limits the step (see step_limit), how often particles were
// sorted.
struct Report {
  std::int64_t steps = 0, sorts = 0;
  double dt = 0;
  const char* limit = "";  // "elastic wave", "particle speed", "viscosity", "given"
};

}  // namespace substep::mpm
