// Drag in proportion to mass, a force -a m v on each vertex: D = a m / 2 |v|^2.
#pragma once

#include <numeric>
#include <vector>

#include "substep/springs/term.h"

namespace substep::springs {

class DragTerm : public Term {
 public:
  // rate a [1/s], masses [kg]
  DragTerm(double rate, std::span<const double> masses)
      : drag_(masses.begin(), masses.end()), vertices_(masses.size()) {
    for (double& m : drag_) m *= rate;
    std::iota(vertices_.begin(), vertices_.end(), 0);
  }
  int arity() const override { return 1; }
  std::span<const std::int32_t> vertices() const override { return vertices_; }
  bool dissipative() const override { return true; }
  double energy(Positions v, std::int64_t begin, std::int64_t end) const override {
    double sum = 0.0;
    for (std::int64_t i = begin; i < end; ++i) sum += 0.5 * drag_[i] * v[i].squaredNorm();
    return sum;
  }
  void derivatives(Positions v, std::int64_t begin, std::int64_t end, double /*kept*/,
                   Vec3* gradient, Mat3* hessian) const override {
    for (std::int64_t i = begin; i < end; ++i) {
      gradient[i - begin] = drag_[i] * v[i];
      if (hessian != nullptr) hessian[i - begin] = drag_[i] * Mat3::Identity();
    }
  }
  double curvature_bound(std::int64_t e) const override { return drag_[e]; }

 private:
  std::vector<double> drag_;  // a m
  std::vector<std::int32_t> vertices_;
};

}  // namespace substep::springs
