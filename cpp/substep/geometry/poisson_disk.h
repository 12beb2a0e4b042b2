// Random points in a box, none of them closer to another than a radius (Poisson-disk samples).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace substep::geometry {

// Dart throwing on a grid of cells of side radius / sqrt(D), each with room for one point: Wei,
// "Parallel Poisson disk sampling", ACM Trans. Graph. 27(3), 2008, section 4, at one resolution. In
// each trial every empty cell gets one dart. Cells three apart cannot conflict, so their darts can
// fly at once: 3^D phases. Phases one after the other would leave a lattice of those that come
// first; so in the first trials the cells take their turns in several rounds, at random, and in
// each the phases have an order of their own. A dart is a function of (seed, cell, trial): the
// result does not depend on the number of threads.
//
// Points in order of their cells; `size` is the box's, whose lowest corner is 0. There must be less
// than 2^31 cells.
template <int D>
std::vector<std::array<double, D>> poisson_disk(const std::array<double, D>& size, double radius,
                                                int trials, std::uint64_t seed, int threads);

extern template std::vector<std::array<double, 2>> poisson_disk<2>(const std::array<double, 2>&,
                                                                   double, int, std::uint64_t, int);
extern template std::vector<std::array<double, 3>> poisson_disk<3>(const std::array<double, 3>&,
                                                                   double, int, std::uint64_t, int);

}  // namespace substep::geometry
