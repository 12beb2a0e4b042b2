#include "substep/linalg/krylov.h"

#include <algorithm>
#include <cmath>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/linalg/vectors.h"

namespace substep {
namespace {

constexpr double kStagnation = 1e-30;  // of a scalar against the norms it is made of: breakdown

double finite(double value, const char* what, std::int32_t iteration) {
  if (!std::isfinite(value)) {
    throw NonFiniteError(std::string(what) + " is not finite in iteration " +
                         std::to_string(iteration));
  }
  return value;
}

// What both methods share: the stop rule, the report and the products.
template <class T>
struct Iteration {
  Iteration(const LinearOperator<T>& a_, const LinearOperator<T>& precondition_,
            std::span<const T> b, std::span<const T> x_, const KrylovOptions& options_)
      : a(a_),
        precondition(precondition_),
        options(options_),
        x(x_.begin(), x_.end()),
        r(b.size()) {
    if (b.size() != x.size()) throw InputError("x: expected as many numbers as b");
    const double size = finite(norm2(b, threads()), "the right-hand side", 0);
    target = std::max(options.rtol * size, options.atol);
    limit = options.max_iterations > 0
                ? options.max_iterations
                : static_cast<std::int32_t>(std::clamp<std::size_t>(2 * b.size(), 100, 1 << 30));
    refresh(b);
    note();
  }

  int threads() const { return options.threads; }
  bool done() const { return report.converged || report.iterations >= limit; }

  void refresh(std::span<const T> b) {  // r = b - A x
    if (std::all_of(x.begin(), x.end(), [](const T& value) { return value == T{}; })) {
      std::copy(b.begin(), b.end(), r.begin());  // the usual first guess costs no product
      return;
    }
    a(x, r);
    for_each_index(r.size(), threads(), [&](std::size_t i) { r[i] = b[i] - r[i]; });
  }

  void note() {
    const double size =
        finite(norm2(std::span<const T>(r), threads()), "the residual", report.iterations);
    report.residuals.push_back(size);
    report.converged = size <= target;
  }

  // z = M^-1 r
  std::span<const T> preconditioned(const std::vector<T>& from, std::vector<T>& z) const {
    if (!precondition) return from;
    precondition(from, z);
    return z;
  }

  const LinearOperator<T>&a, &precondition;
  const KrylovOptions& options;
  std::vector<T> x, r;
  double target;
  std::int32_t limit;
  KrylovReport report;
};

}  // namespace

KrylovReport cg(const LinearOperator<double>& a, std::span<const double> b, std::span<double> x,
                const KrylovOptions& options, const LinearOperator<double>& precondition) {
  Iteration<double> it(a, precondition, b, x, options);
  const std::size_t n = b.size();
  const int threads = options.threads;
  std::vector<double> z(precondition ? n : 0), p(n, 0.0), ap(n);
  double rz_before = 0;
  while (!it.done()) {
    poll_interrupt();
    const auto mr = it.preconditioned(it.r, z);
    const double rz = finite(dot(it.r, mr, threads), "r . M^-1 r", it.report.iterations);
    const double beta = it.report.iterations == 0 ? 0 : rz / rz_before;
    for_each_index(n, threads, [&](std::size_t i) { p[i] = mr[i] + beta * p[i]; });
    a(p, ap);
    const double curvature = finite(dot(p, ap, threads), "p . A p", it.report.iterations);
    if (!(curvature > 0) || !(rz > 0)) {
      it.report.indefinite = true;
      break;
    }
    const double alpha = rz / curvature;
    for_each_index(n, threads, [&](std::size_t i) {
      it.x[i] += alpha * p[i];
      it.r[i] -= alpha * ap[i];
    });
    rz_before = rz;
    ++it.report.iterations;
    it.note();
  }
  std::copy(it.x.begin(), it.x.end(), x.begin());
  if (it.report.indefinite) {
    it.report.remedy =
        "the matrix or the preconditioner is not positive definite: use bicgstab or LU";
  } else if (!it.report.converged) {
    it.report.remedy = "allow more iterations or use a better preconditioner";
  }
  return std::move(it.report);
}

template <class T>
KrylovReport bicgstab(const LinearOperator<T>& a, std::span<const T> b, std::span<T> x,
                      const KrylovOptions& options, const LinearOperator<T>& precondition) {
  Iteration<T> it(a, precondition, b, x, options);
  const std::size_t n = b.size();
  const int threads = options.threads;
  std::vector<T> shadow(it.r), p(n), v(n), t(n), y(precondition ? n : 0), z(precondition ? n : 0);
  T rho{1}, alpha{1}, omega{1};
  const auto part = [&](const std::vector<T>& u, const std::vector<T>& w) {
    return dot(std::span<const T>(u), std::span<const T>(w), threads);
  };
  const auto size = [&](const std::vector<T>& u) { return norm2(std::span<const T>(u), threads); };
  int restarts = 0;
  while (!it.done() && restarts < 10) {
    poll_interrupt();
    const T rho_next = part(shadow, it.r);
    if (!(std::abs(rho_next) > kStagnation * size(shadow) * size(it.r)) || omega == T{} ||
        alpha == T{}) {
      it.refresh(b);  // the recurrence broke down: begin again from here
      shadow = it.r;
      std::fill(p.begin(), p.end(), T{});
      std::fill(v.begin(), v.end(), T{});
      rho = alpha = omega = T{1};
      ++restarts;
      continue;
    }
    const T beta = (rho_next / rho) * (alpha / omega);
    rho = rho_next;
    for_each_index(n, threads,
                   [&](std::size_t i) { p[i] = it.r[i] + beta * (p[i] - omega * v[i]); });
    const auto mp = it.preconditioned(p, y);
    a(mp, v);
    const T shadow_v = part(shadow, v);
    finite(std::abs(shadow_v), "a product with A", it.report.iterations);
    alpha = shadow_v == T{} ? T{} : rho / shadow_v;
    for_each_index(n, threads, [&](std::size_t i) { it.r[i] -= alpha * v[i]; });
    const auto ms = it.preconditioned(it.r, z);
    a(ms, t);
    const double tt = std::real(part(t, t));
    omega = tt > 0 ? part(t, it.r) / tt : T{};
    for_each_index(n, threads, [&](std::size_t i) {
      it.x[i] += alpha * mp[i] + omega * ms[i];
      it.r[i] -= omega * t[i];
    });
    ++it.report.iterations;
    it.note();
  }
  std::copy(it.x.begin(), it.x.end(), x.begin());
  if (!it.report.converged) {
    it.report.remedy = restarts < 10 ? "allow more iterations or use a better preconditioner"
                                     : "the iteration breaks down on this matrix: use LU";
  }
  return std::move(it.report);
}

template KrylovReport bicgstab(const LinearOperator<double>&, std::span<const double>,
                               std::span<double>, const KrylovOptions&,
                               const LinearOperator<double>&);
template KrylovReport bicgstab(const LinearOperator<std::complex<double>>&,
                               std::span<const std::complex<double>>,
                               std::span<std::complex<double>>, const KrylovOptions&,
                               const LinearOperator<std::complex<double>>&);

}  // namespace substep
