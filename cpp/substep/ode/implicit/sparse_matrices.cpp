// s M - J in compressed columns, factorized by linalg/direct/lu.h; the pattern is analysed once.
#include <array>
#include <complex>
#include <optional>
#include <span>
#include <utility>

#include "substep/core/usize.h"
#include "substep/linalg/direct/lu.h"
#include "substep/ode/implicit/matrix_kinds.h"

namespace substep::ode {
namespace {

using Pairs = std::vector<std::pair<std::int32_t, std::int32_t>>;

void append(const SparsePattern& pattern, Pairs& pairs) {
  for (std::int32_t j = 0; j < pattern.cols; ++j) {
    const auto column = usize(j);
    for (std::int32_t k = pattern.start[column]; k < pattern.start[column + 1]; ++k) {
      pairs.emplace_back(pattern.row[usize(k)], j);
    }
  }
}

class SparseNewtonMatrices final : public NewtonMatrices {
 public:
  SparseNewtonMatrices(System& system, std::shared_ptr<Jacobian> jacobian,
                       std::shared_ptr<const MassMatrix> mass)
      : n_(usize(system.size())), jacobian_(std::move(jacobian)), mass_(std::move(mass)) {}

  bool constant() const override { return jacobian_->constant(); }
  bool has_mass() const override { return mass_ != nullptr; }

  std::int64_t evaluate(const JacobianPoint& at) override {
    const std::int64_t evaluations = jacobian_->evaluate(at, J_);
    const SparsePattern* pattern = jacobian_->pattern();
    check_jacobian(at.t, static_cast<std::int64_t>(n_), pattern, J_);
    const SparsePattern full = pattern ? SparsePattern{} : full_pattern(system_size());
    merge(pattern ? *pattern : full);
    return evaluations;
  }

  void factor(int slot, double s) override {
    values_.resize(union_.row.size());
    fill(values_, s);
    auto& lu = real_[usize(slot)];
    if (!lu) lu.emplace(union_);
    lu->factor(std::span<const double>(values_));
  }

  void factor(Complex s) override {
    complex_values_.resize(union_.row.size());
    fill(complex_values_, std::complex<double>(s.re, s.im));
    if (!complex_) complex_.emplace(union_);
    complex_->factor(std::span<const std::complex<double>>(complex_values_));
  }

  void solve(int slot, double* b) override {
    const std::span<double> x(b, n_);
    real_[usize(slot)]->solve(x, x);
  }

  void solve(double* re, double* im) override {
    b_.resize(n_);
    for (std::size_t i = 0; i < n_; ++i) b_[i] = {re[i], im[i]};
    complex_->solve(std::span<const std::complex<double>>(b_), std::span(b_));
    for (std::size_t i = 0; i < n_; ++i) re[i] = b_[i].real(), im[i] = b_[i].imag();
  }

  void multiply_mass(const double* x, double* out) const override {
    mass_->multiply(static_cast<std::int64_t>(n_), x, out);
  }

 private:
  std::int64_t system_size() const { return static_cast<std::int64_t>(n_); }

  // The union of J's pattern with M's, and where the entries of each are in it.
  void merge(const SparsePattern& pattern) {
    if (pattern == merged_) return;
    merged_ = pattern;
    Pairs pairs;
    append(pattern, pairs);
    const std::size_t of_jacobian = pairs.size();
    if (mass_) {
      append(*mass_->pattern, pairs);
      mass_values_ = mass_->values;
    } else {
      for (std::size_t i = 0; i < n_; ++i) {
        pairs.emplace_back(static_cast<std::int32_t>(i), static_cast<std::int32_t>(i));
      }
      mass_values_.assign(n_, 1.0);
    }
    std::vector<std::int32_t> slots;
    const auto n = static_cast<std::int32_t>(n_);
    union_ = build_pattern(n, n, pairs, &slots);
    const auto middle = slots.begin() + static_cast<std::ptrdiff_t>(of_jacobian);
    jacobian_slots_.assign(slots.begin(), middle);
    mass_slots_.assign(middle, slots.end());
    for (auto& lu : real_) lu.reset();
    complex_.reset();
  }

  template <class T>
  void fill(std::vector<T>& values, T s) const {
    std::fill(values.begin(), values.end(), T{});
    for (std::size_t k = 0; k < J_.size(); ++k) {
      values[usize(jacobian_slots_[k])] -= J_[k];
    }
    for (std::size_t k = 0; k < mass_values_.size(); ++k) {
      values[usize(mass_slots_[k])] += s * mass_values_[k];
    }
  }

  std::size_t n_;
  std::shared_ptr<Jacobian> jacobian_;
  std::shared_ptr<const MassMatrix> mass_;
  SparsePattern merged_, union_;
  std::vector<std::int32_t> jacobian_slots_, mass_slots_;
  std::vector<double> J_, mass_values_, values_;
  std::vector<std::complex<double>> complex_values_, b_;
  std::array<std::optional<LU<double>>, kSlots> real_;
  std::optional<LU<std::complex<double>>> complex_;
};

}  // namespace

std::unique_ptr<NewtonMatrices> make_sparse_matrices(System& system,
                                                     std::shared_ptr<Jacobian> jacobian,
                                                     std::shared_ptr<const MassMatrix> mass) {
  return std::make_unique<SparseNewtonMatrices>(system, std::move(jacobian), std::move(mass));
}

}  // namespace substep::ode
