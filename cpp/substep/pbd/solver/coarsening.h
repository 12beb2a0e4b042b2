// A coarser graph of particles and distances that stands for a finer one, made from the graph
// alone: the levels of multilevel.h. Always the same for the same input.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "substep/geometry/vectors.h"

namespace substep::pbd {

// Particles joined by constraints of distance.
struct DistanceGraph {
  struct Edge {
    std::int32_t i, j;
    double length;  // [m]
  };
  std::vector<std::array<double, 3>> rest;  // where particles are when no distance is violated
  std::vector<double> mass;                 // [kg]; 0: pinned
  std::vector<Edge> edges;
  // Of each particle: d d^T of the normal d of the sheet or the tangent d of the rope that it is of
  // in the rest shape, 0 in a solid; of a coarse one their mean.
  std::vector<geometry::Mat3> directions;

  std::int64_t size() const { return static_cast<std::int64_t>(rest.size()); }
  // Particles that move.
  std::int64_t free() const;
};

// Rows of indices, one behind the other.
struct Rows {
  std::vector<std::int32_t> start{0}, index;
};

struct Coarsening {
  static constexpr int kSteps = 3;

  DistanceGraph coarse;
  // Of each fine particle: the coarse ones whose mean displacement it follows; none where no
  // constraint holds it.
  Rows followed;
  // Of each coarse particle: the fine ones that it is the centre of mass of, with the parts of
  // their masses that follow it, which add up to 1; for a pinned particle, that particle.
  Rows members;
  std::vector<double> member_weight;
  // Of each coarse edge: a path of fine edges between its ends, up to kSteps (-1: fewer), and its
  // points, one more than edges (the last one again where there are fewer).
  std::vector<std::array<std::int32_t, kSteps>> path;
  std::vector<std::array<std::int32_t, kSteps + 1>> path_points;
};

// Sets graph.directions from the rest shape.
void find_directions(DistanceGraph& graph);

// Coarse edges have the length that they would have if the rest shape were laid flat, and there are
// none where it turns by more than 60 degrees between their ends.
Coarsening coarsen(const DistanceGraph& fine);

}  // namespace substep::pbd
