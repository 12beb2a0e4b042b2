#include "substep/springs/spring_term.h"

#include <algorithm>
#include <cmath>

namespace substep::springs {
namespace {

// x_i - x_j of spring s.
Vec3 between(const Springs& springs, Positions x, std::int64_t s) {
  return x[springs.vertices[2 * s]] - x[springs.vertices[2 * s + 1]];
}

}  // namespace

double SpringTerm::energy(Positions x, std::int64_t begin, std::int64_t end) const {
  double sum = 0.0;
  for (std::int64_t s = begin; s < end; ++s) {
    const double stretch = between(*springs_, x, s).norm() - springs_->rest_lengths[s];
    sum += 0.5 * springs_->stiffness[s] * stretch * stretch;
  }
  return sum;
}

void SpringTerm::derivatives(Positions x, std::int64_t begin, std::int64_t end, double kept,
                             Vec3* gradient, Mat3* hessian) const {
  for (std::int64_t s = begin; s < end; ++s) {
    const Vec3 e = between(*springs_, x, s);
    const double k = springs_->stiffness[s], r = springs_->rest_lengths[s];
    const double length = e.norm();
    const double inverse = length > 0.0 ? 1.0 / length : 0.0;
    const Vec3 u = inverse * e;
    gradient[s - begin] = k * (length - r) * u;
    if (hessian == nullptr) continue;
    double across = tensions_[s] * inverse;  // T / l
    if (across < 0.0) across *= kept;
    hessian[s - begin] = (k - across) * u * u.transpose();
    hessian[s - begin].diagonal().array() += across;
  }
}

void SpringTerm::lag(Positions x) {
  tensions_.resize(springs_->stiffness.size());
  for (std::size_t s = 0; s < tensions_.size(); ++s) {
    const double length = between(*springs_, x, static_cast<std::int64_t>(s)).norm();
    tensions_[s] = springs_->stiffness[s] * (length - springs_->rest_lengths[s]);
  }
}

void SpringTerm::follow(Positions x, Positions dx, std::int64_t begin, std::int64_t end) {
  for (std::int64_t s = begin; s < end; ++s) {
    const Vec3 e = between(*springs_, x, s);
    const double length = e.norm();
    const double longer = length > 0.0 ? e.dot(between(*springs_, dx, s)) / length : 0.0;
    tensions_[s] = springs_->stiffness[s] * (length + longer - springs_->rest_lengths[s]);
  }
}

void SpringDampingTerm::lag(Positions x) {
  directions_.resize(springs_->stiffness.size());
  for (std::size_t s = 0; s < directions_.size(); ++s) {
    const Vec3 e = between(*springs_, x, static_cast<std::int64_t>(s));
    const double length = e.norm();
    directions_[s] = length > 0.0 ? Vec3(e / length) : Vec3(Vec3::Zero());
  }
}

double SpringDampingTerm::energy(Positions v, std::int64_t begin, std::int64_t end) const {
  double sum = 0.0;
  for (std::int64_t s = begin; s < end; ++s) {
    const double rate = directions_[s].dot(between(*springs_, v, s));
    sum += 0.5 * springs_->damping[s] * rate * rate;
  }
  return sum;
}

void SpringDampingTerm::derivatives(Positions v, std::int64_t begin, std::int64_t end,
                                    double /*kept*/, Vec3* gradient, Mat3* hessian) const {
  for (std::int64_t s = begin; s < end; ++s) {
    const Vec3& u = directions_[s];
    const double c = springs_->damping[s];
    gradient[s - begin] = c * u.dot(between(*springs_, v, s)) * u;
    if (hessian != nullptr) hessian[s - begin] = c * u * u.transpose();
  }
}

}  // namespace substep::springs
