#include "substep/springs/spectrum.h"

#include <Eigen/Dense>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/core/random.h"
#include "substep/core/usize.h"

namespace substep::springs {
namespace {

using Vector = Eigen::VectorXd;

// The largest eigenvalue of a symmetric operator, from below (Golub and Van Loan, "Matrix
// Computations", 4th ed., sec. 10.1): its Krylov space finds the outermost first, and what rounding
// adds to the basis repeats eigenvalues without moving them.
double lanczos(std::int64_t n, const auto& apply) {
  constexpr int kSteps = 100;
  Vector q(n), previous = Vector::Zero(n);
  for (std::int64_t i = 0; i < n; ++i) q[i] = uniform2(0, static_cast<std::uint64_t>(i))[0] - 0.5;
  q.normalize();
  std::vector<double> diagonal, off;
  double beta = 0.0, largest = 0.0;
  for (int k = 0; k < std::min<std::int64_t>(kSteps, n); ++k) {
    poll_interrupt();
    Vector w = apply(q);
    const double alpha = q.dot(w);
    w -= alpha * q + beta * previous;
    diagonal.push_back(alpha);
    Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen;
    eigen.computeFromTridiagonal(
        Eigen::Map<const Vector>(diagonal.data(), static_cast<Eigen::Index>(diagonal.size())),
        Eigen::Map<const Vector>(off.data(), static_cast<Eigen::Index>(off.size())),
        Eigen::EigenvaluesOnly);
    const double found = eigen.eigenvalues().maxCoeff();
    beta = w.norm();
    if (beta <= 1e-12 * found || (k > 10 && found - largest <= 1e-10 * found)) return found;
    largest = found;
    off.push_back(beta);
    previous = q;
    q = w / beta;
  }
  return largest;
}

// The values of K at x, without its negative curvature.
std::vector<double> stiffness(IncrementalPotential& potential, Positions x) {
  std::vector<Vec3> g(x.size());
  std::vector<double> K(potential.pattern().rows.size());
  potential.begin_step(x, x, 1e150);  // neither inertia nor damping
  potential.assemble(x, 0.0, g, K);
  return K;
}

// K p, of which the lower triangle is given.
Vector times(const BlockPattern& lower, const std::vector<double>& K, const Vector& p) {
  Vector y = Vector::Zero(p.size());
  for (std::int64_t j = 0; j < p.size(); ++j) {
    for (std::int32_t k = lower.columns[j]; k < lower.columns[j + 1]; ++k) {
      const std::int32_t i = lower.rows[k];
      y[i] += K[k] * p[j];
      if (i != j) y[j] += K[k] * p[i];
    }
  }
  return y;
}

}  // namespace

Spectrum largest_eigenvalues(IncrementalPotential& potential, Positions x) {
  const std::int64_t n = potential.vertices();
  const auto pinned = potential.pinned();
  Vector scale(3 * n);  // M^-1/2 of what is free
  for (std::int64_t i = 0; i < 3 * n; ++i) {
    scale[i] = pinned[i / 3] ? 0.0 : 1.0 / std::sqrt(potential.masses()[i / 3]);
  }
  std::vector<Vec3> g(usize(n)), v(g.size(), Vec3::Zero());

  const std::vector<double> K = stiffness(potential, x);
  const double omega_squared = lanczos(3 * n, [&](const Vector& q) {
    return Vector(scale.cwiseProduct(times(potential.pattern(), K, scale.cwiseProduct(q))));
  });

  std::vector<Vec3> still(g.size());
  potential.forces(x, v, still);
  const double damping_rate = lanczos(3 * n, [&](const Vector& q) {
    for (std::int64_t i = 0; i < n; ++i)
      v[i] = scale.segment<3>(3 * i).cwiseProduct(q.segment<3>(3 * i));
    potential.forces(x, v, g);
    Vector y(3 * n);
    for (std::int64_t i = 0; i < n; ++i) y.segment<3>(3 * i) = still[i] - g[i];
    return Vector(scale.cwiseProduct(y));
  });
  return {std::sqrt(std::max(omega_squared, 0.0)), std::max(damping_rate, 0.0)};
}

Spectrum spectrum_of(IncrementalPotential& potential, Positions x, Positions v) {
  const std::size_t n = v.size();
  std::vector<Vec3> free(v.begin(), v.end()), still(n), damped(n);
  double mass = 0.0;  // v' M v
  for (std::size_t i = 0; i < n; ++i) {
    if (potential.pinned()[i]) free[i].setZero();
    mass += potential.masses()[i] * free[i].squaredNorm();
  }
  if (!(mass > 0.0)) return {0.0, 0.0};
  const Eigen::Map<const Vector> p(free[0].data(), static_cast<Eigen::Index>(3 * n));
  const double elastic = p.dot(times(potential.pattern(), stiffness(potential, x), p));
  potential.forces(x, std::vector<Vec3>(n, Vec3::Zero()), still);
  potential.forces(x, free, damped);
  double viscous = 0.0;
  for (std::size_t i = 0; i < n; ++i) viscous += free[i].dot(still[i] - damped[i]);
  return {std::sqrt(std::max(elastic / mass, 0.0)), std::max(viscous / mass, 0.0)};
}

}  // namespace substep::springs
