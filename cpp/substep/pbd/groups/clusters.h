// What shape matching (shape_matching.h) is made of.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace substep::pbd {

struct Clusters {
  std::vector<std::int64_t> start;          // members of cluster k: [start[k], start[k + 1])
  std::vector<std::int32_t> particle;       // of each member
  std::vector<std::array<double, 3>> rest;  // position of each member [m]
  std::vector<double> compliance;           // alpha of each cluster [s^2]
  std::vector<double> damping;              // of each cluster [s]: as that of all constraints
  std::vector<double> stiffness;            // of each cluster; below 1 for plain PBD
  double linear = 0;                        // beta
};

}  // namespace substep::pbd
