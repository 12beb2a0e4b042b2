#pragma once

#include <array>
#include <cstdint>

namespace substep::pbd {

using Triple = std::array<double, 3>;

// How a simulation steps (dynamics.h).
struct Options {
  int substeps = 10, iterations = 1;
  bool jacobi = false;          // else Gauss-Seidel
  double relaxation = 1;        // of Jacobi
  Triple gravity{0, 0, -9.81};  // [m/s^2]
  double damping = 0;           // velocities decay with this rate [1/s]
  double margin = 1e-3;         // distance that particles keep from colliders [m]
  int dimension = 3;
  std::int64_t patch_size = 4096;
  int threads = 0;
};

}  // namespace substep::pbd
