// The density that an obstacle of any form adds (Koschier and Bender, "Density maps for improved
// SPH boundary handling", SCA 2017), sampled on a grid about its surface:
//   b(x) = integral of W(x - y) over all y inside of the obstacle.
// Deviations: b is the integral of W itself rather than of their extension by gamma; space is cut
// into cells of h / 8, of which the share inside follows from the distance of the centre as if the
// surface were a plane there; and b is a quadratic B-spline over nodes h / 4 apart, the
// coefficients of which, b - spacing^2 / 8 (second differences), make it third-order accurate. Its
// gradient is the derivative of that spline.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/sampled_distance.h"
#include "substep/pbf/wall_integrals.h"

namespace substep::pbf {

class DensityMap {
 public:
  // Of the inside of the field (f < 0), or, `hollow`, of its outside. Throws InputError where the
  // grid would have more than kMaxNodes nodes.
  DensityMap(const geometry::SampledDistance& field, bool hollow, const KernelFunction& kernel,
             double h, int threads);
  static constexpr std::int64_t kMaxNodes = std::int64_t{1} << 28;

  // At a point in the frame of the field.
  WallDensity operator()(const Vec3& x) const;

 private:
  void sample(const geometry::SampledDistance& field, const KernelFunction& kernel, double h,
              int threads);
  void sharpen();
  float node(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return nodes_[usize((i * shape_[1] + j) * shape_[2] + k)];
  }

  std::array<std::int64_t, 3> shape_;
  Vec3 origin_;
  double spacing_;
  bool hollow_;
  std::vector<float> nodes_;  // of the inside
};

}  // namespace substep::pbf
