// Functions of space at many points.
#pragma once

#include <functional>
#include <span>

#include "substep/geometry/vectors.h"

namespace substep::geometry {

// Writes the numbers of a point.
using EachPoint = std::function<void(const Vec3& point, double* out)>;

// Calls evaluate for each point, three numbers of `points`; each has as many of those of `out`.
void for_each_point(std::span<const double> points, std::span<double> out,
                    const EachPoint& evaluate, int threads);

}  // namespace substep::geometry
