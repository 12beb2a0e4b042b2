#include "substep/mpm/implicit/implicit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "substep/linalg/krylov.h"
#include "substep/linalg/newton.h"
#include "substep/linalg/vectors.h"

namespace substep::mpm {
namespace {

// Friction is sharp at once; where that does not converge, it begins smooth.
constexpr double kSmoothings[] = {1, 100};
constexpr double kRounding = 1e-15;         // of energies against moduli: a few units
constexpr double kForcing = 0.1;            // of the first linear system of a solve
constexpr double kContactTolerance = 0.01;  // of the obstacles' impulses

// The inverse of B, D x D rows of kNodeLanes<D>, in its place; where B is not positive definite,
// that of its diagonal's absolute values. `mass` is a part of the diagonal.
template <int D>
void invert_block(double* block, double mass) {
  using Matrix = Eigen::Matrix<double, D, D>;
  Matrix B;
  for (int l = 0; l < D; ++l) {
    for (int j = 0; j < D; ++j) B(l, j) = block[l * kNodeLanes<D> + j];
  }
  B = (0.5 * (B + B.transpose())).eval();
  const double minor = B(0, 0) * B(1, 1) - B(0, 1) * B(0, 1);
  const bool definite = B(0, 0) > 0 && minor > 0 && B.determinant() > 0;
  const Matrix inverse =
      definite ? Matrix(B.inverse())
               : Matrix(B.diagonal().cwiseAbs().cwiseMax(mass).cwiseInverse().asDiagonal());
  for (int l = 0; l < D; ++l) {
    for (int j = 0; j < D; ++j) block[l * kNodeLanes<D> + j] = inverse(l, j);
  }
}

}  // namespace

// What Newton's method solves (linalg/newton.h), for given states of the contacts.
template <class Real, int D>
struct ImplicitStep<Real, D>::Problem {
  static constexpr std::size_t kL = kNodeLanes<D>;

  ImplicitStep& step;
  std::vector<double> target;  // v^n + dt g
  double unit;                 // of the residual's norm: tolerance * scale * sqrt(sum m)
  int threads;
  bool potential;
  std::vector<double> at, raw;  // velocities of the last evaluation; the residual there, with the
                                // impulses of the obstacles still in it
  std::vector<double> blocks;
  double energy = 0;

  double mass(std::size_t k) const { return step.nodes_.mass[k / kL]; }

  void evaluate(std::span<const double> v) {
    if (std::equal(v.begin(), v.end(), at.begin(), at.end())) return;
    at.assign(v.begin(), v.end());
    energy = step.particles_.evaluate(at);
    raw.resize(at.size());
    for_each_index(raw.size(), threads,
                   [&](std::size_t k) { raw[k] = mass(k) * (at[k] - target[k]); });
    step.particles_.add_gradient(raw);
  }

  // sum |r_i|^2 / m_i
  double squares(std::span<const double> r) const {
    return sum_terms<double>(
        static_cast<std::int64_t>(r.size()), [&](std::size_t k) { return r[k] * r[k] / mass(k); },
        threads);
  }

  double merit(std::span<const double> v) {
    evaluate(v);
    if (!potential) {
      std::vector<double> r(v.size());
      gradient(v, r);
      return 0.5 * squares(r);
    }
    const double kinetic = sum_terms<double>(
        static_cast<std::int64_t>(v.size()),
        [&](std::size_t k) {
          const double change = at[k] - target[k];
          return 0.5 * mass(k) * change * change;
        },
        threads);
    return kinetic + energy + step.contacts_.energy(v);
  }

  void gradient(std::span<const double> v, std::span<double> g) {
    evaluate(v);
    std::copy(raw.begin(), raw.end(), g.begin());
    step.contacts_.add_gradient(v, g);
    step.contacts_.project(g);
  }

  double rounding() const { return potential ? kRounding * step.particles_.stiffness() : 0; }

  double residual(std::span<const double> g) const { return std::sqrt(squares(g)) / unit; }

  void product(std::span<const double> x, std::span<double> y) {
    for_each_index(x.size(), threads, [&](std::size_t k) { y[k] = mass(k) * x[k]; });
    step.particles_.add_product(x, y);
    step.contacts_.add_product(x, y);
    step.contacts_.project(y);
  }

  void precondition(std::span<const double> r, std::span<double> z) {
    for_each_index(step.nodes_.count(), threads, [&](std::size_t i) {
      const double* const B = blocks.data() + i * D * kL;
      for (std::size_t l = 0; l < kL; ++l) z[i * kL + l] = 0;
      for (std::size_t l = 0; l < D; ++l) {
        for (std::size_t j = 0; j < D; ++j) z[i * kL + j] += B[l * kL + j] * r[i * kL + l];
      }
    });
    step.contacts_.project(z);
  }

  void linearise(std::span<const double> v) {
    step.particles_.linearise();
    step.contacts_.linearise(v);
    blocks.assign(step.nodes_.count() * D * kL, 0);
    step.particles_.add_diagonal(blocks);
    step.contacts_.add_diagonal(blocks);
    for_each_index(step.nodes_.count(), threads, [&](std::size_t i) {
      const double m = step.nodes_.mass[i];
      for (std::size_t d = 0; d < D; ++d) blocks[i * D * kL + d * kL + d] += m;
      invert_block<D>(blocks.data() + i * D * kL, m);
    });
  }

  double direction(std::span<const double> v, std::span<const double> g, double forcing,
                   std::span<double> d) {
    evaluate(v);
    linearise(v);
    std::vector<double> b(g.size());
    for (std::size_t k = 0; k < g.size(); ++k) b[k] = -g[k];
    std::fill(d.begin(), d.end(), 0.0);
    // More than the tolerance asks for is not needed.
    const double rtol = std::max(forcing, std::min(0.25 / residual(g), kForcing));
    const KrylovOptions options{
        .rtol = rtol, .max_iterations = step.options_.max_krylov, .threads = threads};
    const LinearOperator<double> a = [&](std::span<const double> x, std::span<double> y) {
      product(x, y);
    };
    const LinearOperator<double> m = [&](std::span<const double> x, std::span<double> y) {
      precondition(x, y);
    };
    if (!potential) {
      const KrylovReport krylov = bicgstab<double>(a, b, d, options, m);
      step.report_.krylov += 2 * krylov.iterations;
      return -squares(g) * (1 - std::min(rtol, 0.9));
    }
    const KrylovReport krylov = cg(a, b, d, options, m);
    step.report_.krylov += krylov.iterations;
    if (krylov.indefinite) {
      ++step.report_.indefinite;
      if (krylov.iterations == 0) precondition(b, d);
    }
    return dot(g, d, threads);
  }
};

template <class Real, int D>
const ImplicitReport& ImplicitStep<Real, D>::solve(const Particles<Real, D>& particles,
                                                   std::span<Real> nodes, double dt,
                                                   const geometry::Vec3& gravity, int order,
                                                   Form form,
                                                   std::span<const geometry::Collider> colliders,
                                                   std::span<const Boundary> boundaries,
                                                   int threads) {
  constexpr std::size_t kL = kNodeLanes<D>;
  report_ = {};
  nodes_.template assign<Real>(particles.layout, nodes);
  particles_.assign(particles, nodes_, order, form, dt, threads);
  distances_.update(particles.layout, true, colliders, threads);
  contacts_.assign(nodes_, distances_, colliders, boundaries, particles.cell);

  // Momentum to velocity; the first guess is the better one of v^n and v^n + dt g.
  const std::size_t n = nodes_.unknowns();
  std::vector<double> before(n, 0.0), target(n, 0.0);
  double total = 0, squares = 0;
  for (std::size_t i = 0; i < nodes_.count(); ++i) {
    const Real* const node = nodes.data() + usize(nodes_.slots[i]) * transfer::kNodeReals;
    total += nodes_.mass[i];
    for (std::size_t d = 0; d < D; ++d) {
      const double v = static_cast<double>(node[d]) / nodes_.mass[i];
      before[i * kL + d] = v;
      target[i * kL + d] = v + dt * gravity[static_cast<int>(d)];
      squares += nodes_.mass[i] * v * v;
    }
  }
  if (n == 0) {
    report_.converged = report_.settled = true;
    exchanges_.assign(colliders.size(), {});
    return report_;
  }
  report_.scale = std::max(gravity.norm() * dt, std::sqrt(squares / total));
  if (!(report_.scale > 0)) report_.scale = particles.cell / dt;
  Problem problem{.step = *this,
                  .target = target,
                  .unit = options_.tolerance * report_.scale * std::sqrt(total),
                  .threads = threads,
                  .potential = particles_.hyperelastic(),
                  .at = {},
                  .raw = {},
                  .blocks = {}};
  for (const double smoothing : kSmoothings) {
    contacts_.predict(target, options_.slip * report_.scale, smoothing);
    contacts_.impose(before);
    std::vector<double> v = target;
    contacts_.impose(v);
    const double fallen = problem.merit(v);
    if (!(fallen <= problem.merit(before))) {
      v = before;
      problem.evaluate(v);
      contacts_.press(problem.raw);
    }
    if (!solve_rounds(problem, v)) continue;
    for (std::size_t i = 0; i < nodes_.count(); ++i) {
      Real* const node = nodes.data() + usize(nodes_.slots[i]) * transfer::kNodeReals;
      for (std::size_t d = 0; d < D; ++d) {
        node[d] = static_cast<Real>(nodes_.mass[i] * v[i * kL + d]);
      }
    }
    break;
  }
  return report_;
}

// Newton's method, and again where that changes what touches or how it is pressed.
template <class Real, int D>
bool ImplicitStep<Real, D>::solve_rounds(Problem& problem, std::span<double> v) {
  const NewtonOptions newton_options{.max_iterations = options_.max_newton,
                                     .max_forcing = kForcing};
  report_.settled = false;
  std::vector<double> last;  // of the rounds that converged
  for (int round = 0; round < options_.max_rounds && !report_.settled; ++round) {
    ++report_.rounds;
    contacts_.impose(v);
    const NewtonReport found = newton(problem, v, newton_options);
    report_.newton += found.iterations;
    report_.halvings += found.halvings;
    report_.residuals.insert(report_.residuals.end(), found.residuals.begin(),
                             found.residuals.end());
    report_.converged = round > 0 || found.converged;
    report_.remedy = found.converged ? "" : found.remedy;
    if (!report_.converged) return false;
    if (!found.converged) {  // that of the round before, which does not settle
      std::copy(last.begin(), last.end(), v.begin());
      break;
    }
    last.assign(v.begin(), v.end());
    problem.evaluate(v);
    exchanges_ = contacts_.exchanges(problem.raw);
    report_.settled = !contacts_.update(v, problem.raw, kContactTolerance);
  }
  if (!report_.settled) contacts_.keep_out(v);
  return true;
}

template class ImplicitStep<float, 2>;
template class ImplicitStep<float, 3>;
template class ImplicitStep<double, 2>;
template class ImplicitStep<double, 3>;

}  // namespace substep::mpm
