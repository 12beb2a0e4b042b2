// GCC 12 takes its own vector intrinsics for uninitialized.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"

#include <Eigen/LU>
#include <algorithm>
#include <complex>
#include <string>

#include "substep/core/usize.h"
#include "substep/ode/implicit/matrix_kinds.h"
#include "substep/ode/stepping/step_control.h"

namespace substep::ode {
namespace {

// J and M as full matrices. Few rows are factorized by small_lu.h, more by Eigen's blocked LU.
class DenseNewtonMatrices final : public NewtonMatrices {
 public:
  DenseNewtonMatrices(System& system, std::shared_ptr<Jacobian> jacobian,
                      std::shared_ptr<const MassMatrix> mass)
      : n_(system.size()), jacobian_(std::move(jacobian)), mass_(std::move(mass)), b_(usize(n_)) {
    const auto n = usize(n_);
    J_.resize(n * n);
    if (mass_) {
      M_.resize(n * n);
      spread(mass_->pattern.get(), mass_->values, M_);
    }
    if (n_ > kSmall) return;
    for (auto& a : real_) a.resize(n * n);
    complex_.resize(n * n);
  }

  bool constant() const override { return jacobian_->constant(); }
  bool has_mass() const override { return !M_.empty(); }

  std::int64_t evaluate(const JacobianPoint& at) override {
    const std::int64_t evaluations = jacobian_->evaluate(at, values_);
    check_jacobian(at.t, n_, jacobian_->pattern(), values_);
    spread(jacobian_->pattern(), values_, J_);
    return evaluations;
  }

  void factor(int slot, double s) override {
    if (n_ <= kSmall) {
      auto& a = real_[slot];
      fill(s, [&](std::size_t k, double value) { a[k] = value; });
      const std::int64_t row = lu_factor(n_, a.data(), pivot_[slot]);
      if (row >= 0) throw singular_matrix(row);
      return;
    }
    big_.resize(n_, n_);
    fill(s, [&](std::size_t k, double value) { big_.data()[k] = value; });
    lu_[slot].compute(big_);
    check(lu_[slot]);
  }

  void factor(Complex s) override {
    const auto put = [&](auto&& set) {
      fill(s.re,
           [&](std::size_t k, double value) { set(k, value, M_.empty() ? 0.0 : s.im * M_[k]); });
    };
    if (n_ <= kSmall) {
      put([&](std::size_t k, double re, double im) { complex_[k] = {re, im}; });
      if (M_.empty()) {
        for (std::size_t i = 0; i < b_.size(); ++i) complex_[i * b_.size() + i].im = s.im;
      }
      const std::int64_t row = lu_factor(n_, complex_.data(), complex_pivot_);
      if (row >= 0) throw singular_matrix(row);
      return;
    }
    big_complex_.resize(n_, n_);
    put([&](std::size_t k, double re, double im) { big_complex_.data()[k] = {re, im}; });
    if (M_.empty()) big_complex_.diagonal().array() += std::complex<double>(0.0, s.im);
    complex_lu_.compute(big_complex_);
    check(complex_lu_);
  }

  void solve(int slot, double* b) override {
    if (n_ <= kSmall) return lu_solve(n_, real_[slot].data(), pivot_[slot], b);
    Eigen::Map<Eigen::VectorXd> x(b, n_);
    x = lu_[slot].solve(x).eval();
  }

  void solve(double* re, double* im) override {
    if (n_ <= kSmall) {
      for (std::size_t i = 0; i < b_.size(); ++i) b_[i] = {re[i], im[i]};
      lu_solve(n_, complex_.data(), complex_pivot_, b_.data());
      for (std::size_t i = 0; i < b_.size(); ++i) re[i] = b_[i].re, im[i] = b_[i].im;
      return;
    }
    Eigen::Map<Eigen::VectorXd> x(re, n_), y(im, n_);
    Eigen::VectorXcd z(n_);
    z.real() = x;
    z.imag() = y;
    z = complex_lu_.solve(z).eval();
    x = z.real();
    y = z.imag();
  }

  void multiply_mass(const double* x, double* out) const override { mass_->multiply(n_, x, out); }

 private:
  static constexpr std::int64_t kSmall = 24;

  void spread(const SparsePattern* pattern, const std::vector<double>& values,
              std::vector<double>& full) const {
    if (!pattern) {
      std::copy(values.begin(), values.end(), full.begin());
      return;
    }
    std::fill(full.begin(), full.end(), 0.0);
    for (std::int64_t j = 0; j < n_; ++j) {
      const auto begin = usize(pattern->start[usize(j)]);
      const auto end = usize(pattern->start[usize(j) + 1]);
      for (std::size_t k = begin; k < end; ++k) {
        full[usize(j * n_ + pattern->row[k])] = values[k];
      }
    }
  }

  // put(k, s M_k - J_k)
  template <class Put>
  void fill(double s, Put&& put) const {
    const std::size_t n = b_.size();
    if (M_.empty()) {
      for (std::size_t k = 0; k < n * n; ++k) put(k, -J_[k]);
      for (std::size_t i = 0; i < n; ++i) put(i * n + i, s - J_[i * n + i]);
    } else {
      for (std::size_t k = 0; k < n * n; ++k) put(k, s * M_[k] - J_[k]);
    }
  }

  template <class Factors>
  static void check(const Factors& lu) {
    const auto& U = lu.matrixLU();
    for (Eigen::Index i = 0; i < U.rows(); ++i) {
      const double size = std::abs(U(i, i));
      if (!(size > 0.0 && size < HUGE_VAL)) throw singular_matrix(i);
    }
  }

  std::int64_t n_;
  std::shared_ptr<Jacobian> jacobian_;
  std::shared_ptr<const MassMatrix> mass_;
  std::vector<double> values_, J_, M_;
  std::vector<double> real_[kSlots];
  std::vector<Complex> complex_, b_;
  std::int32_t pivot_[kSlots][kSmall] = {}, complex_pivot_[kSmall] = {};
  Eigen::MatrixXd big_;
  Eigen::MatrixXcd big_complex_;
  Eigen::PartialPivLU<Eigen::MatrixXd> lu_[kSlots];
  Eigen::PartialPivLU<Eigen::MatrixXcd> complex_lu_;
};

}  // namespace

std::unique_ptr<NewtonMatrices> make_dense_matrices(System& system,
                                                    std::shared_ptr<Jacobian> jacobian,
                                                    std::shared_ptr<const MassMatrix> mass) {
  return std::make_unique<DenseNewtonMatrices>(system, std::move(jacobian), std::move(mass));
}

}  // namespace substep::ode
