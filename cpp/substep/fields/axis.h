#pragma once

#include <vector>

namespace substep::fields {

// Of a grid.
struct Axis {
  std::vector<double> nodes;  // rising
  double wrap = 0;            // period in which coordinates are reduced; 0: none
  bool closed = false;        // the last node is followed by the first, one period on
};

}  // namespace substep::fields
