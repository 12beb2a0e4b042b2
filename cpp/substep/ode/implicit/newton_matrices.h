// The matrices s M - J of the simplified Newton iterations of implicit methods, s real or complex:
// kept in factors (dense, sparse) or solved by iteration (Krylov).
#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "substep/ode/implicit/jacobian.h"
#include "substep/ode/implicit/small_lu.h"
#include "substep/ode/stepping/system.h"

namespace substep::ode {

class NewtonMatrices {
 public:
  static constexpr int kSlots = 2;  // real matrices at a time

  NewtonMatrices() = default;
  NewtonMatrices(const NewtonMatrices&) = delete;
  NewtonMatrices& operator=(const NewtonMatrices&) = delete;
  virtual ~NewtonMatrices() = default;

  // J at another point; what was factorized goes on with the old one. The number of evaluations
  // of f that it took. Throws NonFiniteError with the row.
  virtual std::int64_t evaluate(const JacobianPoint& at) = 0;
  virtual bool constant() const = 0;  // J is the same everywhere

  virtual bool factorizes() const { return true; }  // or solves by iteration

  // Makes s M - J ready. Throws SingularMatrixError with the row.
  virtual void factor(int slot, double s) = 0;
  virtual void factor(Complex s) = 0;

  // b becomes (s M - J)^-1 b.
  virtual void solve(int slot, double* b) = 0;
  virtual void solve(double* re, double* im) = 0;

  // What a solve by iteration must reach: a residual that leaves an error of about `tolerance` in
  // units of scale.
  virtual void set_accuracy(const double* /*scale*/, double /*tolerance*/) {}

  // Whether the last solve reached that, and what all of them took since the last factor().
  virtual bool reached() const { return true; }
  virtual double operations() const { return 0; }

  virtual bool has_mass() const = 0;
  virtual void multiply_mass(const double* x, double* out) const = 0;  // out = M x
};

std::unique_ptr<NewtonMatrices> make_newton_matrices(System& system, const StepOptions& options);

// The first entry of J that is not finite, as an exception.
NonFiniteError jacobian_not_finite(double t, std::int64_t row, std::int64_t column);
SingularMatrixError singular_matrix(std::int64_t row);

// For a small system that knows its Jacobian: all in registers and on the stack.
template <class Sys>
class StaticNewtonMatrices final : public NewtonMatrices {
 public:
  static constexpr int N = Sys::kSize;

  explicit StaticNewtonMatrices(const Sys& system) : system_(system) {}

  std::int64_t evaluate(const JacobianPoint& at) override {
    system_.eval_jacobian(at.t, at.y, jacobian_);
    for (int k = 0; k < N * N; ++k) {
      if (!std::isfinite(jacobian_[k])) throw jacobian_not_finite(at.t, k % N, k / N);
    }
    return 0;
  }
  bool constant() const override { return false; }

  void factor(int slot, double s) override {
    for (int k = 0; k < N * N; ++k) real_[slot][k] = -jacobian_[k];
    for (int i = 0; i < N; ++i) real_[slot][i * N + i] += s;
    const std::int64_t row = lu_factor(N, real_[slot], pivot_[slot]);
    if (row >= 0) throw singular_matrix(row);
  }
  void factor(Complex s) override {
    for (int k = 0; k < N * N; ++k) complex_[k] = {-jacobian_[k], 0.0};
    for (int i = 0; i < N; ++i) complex_[i * N + i] = {s.re - jacobian_[i * N + i], s.im};
    const std::int64_t row = lu_factor(N, complex_, complex_pivot_);
    if (row >= 0) throw singular_matrix(row);
  }
  void solve(int slot, double* b) override { lu_solve(N, real_[slot], pivot_[slot], b); }
  void solve(double* re, double* im) override {
    Complex b[N];
    for (int i = 0; i < N; ++i) b[i] = {re[i], im[i]};
    lu_solve(N, complex_, complex_pivot_, b);
    for (int i = 0; i < N; ++i) re[i] = b[i].re, im[i] = b[i].im;
  }
  bool has_mass() const override { return false; }
  void multiply_mass(const double*, double*) const override {}

 private:
  const Sys& system_;
  double jacobian_[N * N] = {}, real_[kSlots][N * N] = {};
  Complex complex_[N * N];
  std::int32_t pivot_[kSlots][N] = {}, complex_pivot_[N] = {};
};

}  // namespace substep::ode
