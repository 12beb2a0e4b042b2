// s M - J by iteration as long as that is quick, then by factors. Of a line of cells or of a
// network factors cost little from the start; of a mesh they cost much, but iterations do not
// converge wherever couplings are strong and one-sided.
#include <array>
#include <utility>

#include "substep/core/usize.h"
#include "substep/linalg/direct/lu.h"
#include "substep/ode/implicit/matrix_kinds.h"

namespace substep::ode {
namespace {

// Operations for each entry of the factors, above which iterations are tried, and how often the
// operations of a real and a complex factor iterations may take: measured, docs/ode_implicit.md.
constexpr double kMesh = 15, kPatience = 5;

// J, of which the last values can be had again.
class KeptJacobian final : public Jacobian {
 public:
  explicit KeptJacobian(std::shared_ptr<Jacobian> jacobian) : jacobian_(std::move(jacobian)) {}
  const SparsePattern* pattern() const override { return jacobian_->pattern(); }
  bool constant() const override { return jacobian_->constant(); }
  bool native() const override { return jacobian_->native(); }
  std::int64_t evaluate(const JacobianPoint& at, std::vector<double>& values) override {
    std::int64_t evaluations = 0;
    if (!again) evaluations = jacobian_->evaluate(at, values_);
    values = values_;
    return evaluations;
  }
  bool again = false;

 private:
  std::shared_ptr<Jacobian> jacobian_;
  std::vector<double> values_;
};

class AutomaticNewtonMatrices final : public NewtonMatrices {
 public:
  AutomaticNewtonMatrices(System& system, std::shared_ptr<Jacobian> jacobian,
                          const StepOptions& options)
      : n_(usize(system.size())),
        jacobian_(std::make_shared<KeptJacobian>(std::move(jacobian))),
        iterations_(make_krylov_matrices(system, jacobian_, options)),
        factors_(make_sparse_matrices(system, jacobian_, nullptr)) {}

  bool constant() const override { return jacobian_->constant(); }
  bool has_mass() const override { return false; }
  bool factorizes() const override { return !iterations_; }

  std::int64_t evaluate(const JacobianPoint& at) override {
    const std::int64_t evaluations = now().evaluate(at);
    t_ = at.t;
    if (!iterations_ || operations_ > 0) return evaluations;
    const FactorCost cost = factor_cost(*jacobian_->pattern());
    operations_ = cost.operations + 1;
    if (cost.operations < kMesh * cost.entries) use_factors();
    return evaluations;
  }

  void factor(int slot, double s) override { now().factor(slot, real_[usize(slot)] = s); }
  void factor(Complex s) override { now().factor(complex_ = s); }

  void solve(int slot, double* b) override {
    if (iterations_) {
      b_.assign(b, b + n_);
      iterations_->solve(slot, b);
      if (quick()) return;
      use_factors();
      std::copy(b_.begin(), b_.end(), b);
    }
    factors_->solve(slot, b);
  }
  void solve(double* re, double* im) override {
    if (iterations_) {
      b_.assign(re, re + n_);
      b_.insert(b_.end(), im, im + n_);
      iterations_->solve(re, im);
      if (quick()) return;
      use_factors();
      const auto middle = b_.begin() + static_cast<std::ptrdiff_t>(n_);
      std::copy(b_.begin(), middle, re), std::copy(middle, b_.end(), im);
    }
    factors_->solve(re, im);
  }

  void set_accuracy(const double* scale, double tolerance) override {
    now().set_accuracy(scale, tolerance);
  }
  void multiply_mass(const double*, double*) const override {}

 private:
  NewtonMatrices& now() { return iterations_ ? *iterations_ : *factors_; }

  bool quick() const {
    return iterations_->reached() && iterations_->operations() < kPatience * 5 * operations_;
  }

  // From now on, with J and the shifts at hand.
  void use_factors() {
    jacobian_->again = true;
    factors_->evaluate({.t = t_});
    jacobian_->again = false;
    for (int slot = 0; slot < kSlots; ++slot) {
      if (real_[usize(slot)] != 0) factors_->factor(slot, real_[usize(slot)]);
    }
    if (complex_.im != 0) factors_->factor(complex_);
    iterations_.reset();
  }

  std::size_t n_;
  std::shared_ptr<KeptJacobian> jacobian_;
  std::unique_ptr<NewtonMatrices> iterations_, factors_;  // iterations: none once given up
  double t_ = 0, operations_ = 0;
  std::array<double, kSlots> real_{};
  Complex complex_{};
  std::vector<double> b_;
};

}  // namespace

std::unique_ptr<NewtonMatrices> make_automatic_matrices(System& system,
                                                        std::shared_ptr<Jacobian> jacobian,
                                                        const StepOptions& options) {
  return std::make_unique<AutomaticNewtonMatrices>(system, std::move(jacobian), options);
}

}  // namespace substep::ode
