#include "substep/ode/implicit/jacobian.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "substep/core/usize.h"

namespace substep::ode {
namespace {

class SystemJacobian final : public Jacobian {
 public:
  explicit SystemJacobian(System& system) : system_(system) {}

  const SparsePattern* pattern() const override { return system_.jacobian_pattern(); }
  bool native() const override { return system_.native(); }
  std::int64_t evaluate(const JacobianPoint& at, std::vector<double>& values) override {
    const SparsePattern* sparse = pattern();
    const auto n = usize(system_.size());
    values.resize(sparse ? usize(sparse->entries()) : n * n);
    system_.jacobian(at.t, at.y, values.data());
    return 0;
  }

 private:
  System& system_;
};

// Forward differences with the increments of CVODE and LSODA (Hindmarsh et al., ACM TOMS 31 (2005)
// 363, section 2.1): sigma_j = max(sqrt(u) |y_j|, sigma_0 scale_j), sigma_0 = 1000 n u |h| |f|.
class FiniteDifferences final : public Jacobian {
 public:
  FiniteDifferences(System& system, std::unique_ptr<const SparsePattern> own,
                    const SparsePattern* pattern)
      : system_(system), own_(std::move(own)), pattern_(pattern) {
    const auto n = usize(system.size());
    y_.resize(n), f_.resize(n), increment_.resize(n);
    if (!pattern_) return;
    const std::vector<std::int32_t> group = group_columns(*pattern_);
    for (std::size_t j = 0; j < n; ++j) {
      const auto g = usize(group[j]);
      if (g >= columns_.size()) columns_.resize(g + 1);
      columns_[g].push_back(static_cast<std::int32_t>(j));
    }
  }

  const SparsePattern* pattern() const override { return pattern_; }
  bool native() const override { return system_.native(); }

  std::int64_t evaluate(const JacobianPoint& at, std::vector<double>& values) override {
    const auto n = usize(system_.size());
    values.resize(pattern_ ? usize(pattern_->entries()) : n * n);
    set_increments(at);
    std::copy_n(at.y, n, y_.begin());
    const std::size_t groups = pattern_ ? columns_.size() : n;
    std::int64_t evaluations = 0;
    for (std::size_t g = 0; g < groups; ++g) {
      shift(at, g, 1.0);
      system_.rhs(at.t, y_.data(), f_.data());
      ++evaluations;
      if (!std::all_of(f_.begin(), f_.end(), [](double f) { return std::isfinite(f); })) {
        shift(at, g, -1.0);  // the end of the domain of f may be near
        system_.rhs(at.t, y_.data(), f_.data());
        ++evaluations;
      }
      divide(at, g, values.data());
      shift(at, g, 0.0);
    }
    return evaluations;
  }

 private:
  void set_increments(const JacobianPoint& at) {
    constexpr double u = std::numeric_limits<double>::epsilon();
    const std::size_t n = y_.size();
    double squares = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      squares += at.f[i] / at.scale[i] * (at.f[i] / at.scale[i]);
    }
    const double norm = std::sqrt(squares / static_cast<double>(n));
    double sigma0 = 1000.0 * static_cast<double>(n) * u * std::fabs(at.h) * norm;
    if (!(sigma0 > 0.0 && std::isfinite(sigma0))) sigma0 = 1.0;
    // Of algebraic equations: what survives a sum with the other components.
    double least = 0.0;
    if (at.algebraic) {
      for (std::size_t i = 0; i < n; ++i) least = std::max(least, 1e-11 * std::fabs(at.y[i]));
    }
    for (std::size_t j = 0; j < n; ++j) {
      const double sigma =
          std::max({std::sqrt(u) * std::fabs(at.y[j]), sigma0 * at.scale[j], least});
      // Towards where the solution goes, by a number that y_j + sigma - y_j is exactly.
      const double signed_sigma = at.f[j] * at.h < 0.0 ? -sigma : sigma;
      const volatile double there = at.y[j] + signed_sigma;
      increment_[j] = there - at.y[j];
    }
  }

  template <class Use>
  void each_column(std::size_t g, Use&& use) const {
    if (!pattern_) return use(g);
    for (const std::int32_t j : columns_[g]) use(usize(j));
  }

  void shift(const JacobianPoint& at, std::size_t g, double sign) {
    each_column(g, [&](std::size_t j) { y_[j] = at.y[j] + sign * increment_[j]; });
  }

  void divide(const JacobianPoint& at, std::size_t g, double* values) const {
    const std::size_t n = y_.size();
    each_column(g, [&](std::size_t j) {
      const double inverse = 1.0 / (y_[j] - at.y[j]);
      if (!pattern_) {
        for (std::size_t i = 0; i < n; ++i) values[j * n + i] = (f_[i] - at.f[i]) * inverse;
        return;
      }
      for (std::int32_t k = pattern_->start[j]; k < pattern_->start[j + 1]; ++k) {
        const auto i = usize(pattern_->row[usize(k)]);
        values[k] = (f_[i] - at.f[i]) * inverse;
      }
    });
  }

  System& system_;
  std::unique_ptr<const SparsePattern> own_;
  const SparsePattern* pattern_;
  std::vector<std::vector<std::int32_t>> columns_;  // of each group
  std::vector<double> y_, f_, increment_;
};

}  // namespace

void MassMatrix::multiply(std::int64_t n, const double* x, double* out) const {
  std::fill(out, out + n, 0.0);
  for (std::int64_t j = 0; j < n; ++j) {
    if (!pattern) {
      const double* column = values.data() + j * n;
      for (std::int64_t i = 0; i < n; ++i) out[i] += column[i] * x[j];
      continue;
    }
    const auto at = usize(j);
    for (std::int32_t k = pattern->start[at]; k < pattern->start[at + 1]; ++k) {
      const auto entry = usize(k);
      out[pattern->row[entry]] += values[entry] * x[j];
    }
  }
}

std::vector<std::int32_t> group_columns(const SparsePattern& pattern) {
  const auto n = usize(pattern.cols);
  // Columns with a nonzero in each row.
  std::vector<std::int32_t> begin(n + 1, 0), column(pattern.row.size());
  for (const std::int32_t i : pattern.row) ++begin[usize(i) + 1];
  for (std::size_t i = 0; i < n; ++i) begin[i + 1] += begin[i];
  std::vector<std::int32_t> next(begin.begin(), begin.end() - 1);
  const auto rows_of = [&](std::size_t j, auto&& use) {
    for (std::int32_t k = pattern.start[j]; k < pattern.start[j + 1]; ++k) {
      use(usize(pattern.row[usize(k)]));
    }
  };
  for (std::size_t j = 0; j < n; ++j) {
    rows_of(j, [&](std::size_t i) { column[usize(next[i]++)] = static_cast<std::int32_t>(j); });
  }
  std::vector<std::int32_t> group(n, -1), taken(n + 1, -1);  // taken[g] = j: not for column j
  for (std::size_t j = 0; j < n; ++j) {
    rows_of(j, [&](std::size_t i) {
      for (std::int32_t k = begin[i]; k < begin[i + 1]; ++k) {
        const std::int32_t other = group[usize(column[usize(k)])];
        if (other >= 0) taken[usize(other)] = static_cast<std::int32_t>(j);
      }
    });
    std::int32_t g = 0;
    while (taken[usize(g)] == static_cast<std::int32_t>(j)) ++g;
    group[j] = g;
  }
  return group;
}

std::shared_ptr<Jacobian> make_jacobian(System& system) {
  if (system.has_jacobian()) return std::make_shared<SystemJacobian>(system);
  return std::make_shared<FiniteDifferences>(system, nullptr, system.jacobian_pattern());
}

std::shared_ptr<Jacobian> make_finite_differences(System& system,
                                                  std::unique_ptr<const SparsePattern> pattern) {
  const SparsePattern* shared = pattern.get();
  return std::make_shared<FiniteDifferences>(system, std::move(pattern), shared);
}

}  // namespace substep::ode
