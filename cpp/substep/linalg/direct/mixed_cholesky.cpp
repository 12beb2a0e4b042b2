#include "substep/linalg/direct/mixed_cholesky.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "substep/core/errors.h"
#include "substep/linalg/krylov.h"

namespace substep {
namespace {

constexpr int kMostIterations = 8;  // of conjugate gradients: more cost more than float64 does

// Brings the largest number near 1, as the range of float32 is narrow; returns the power of two by
// which it multiplied.
double normalize(std::span<double> x) {
  double largest = 0.0;
  for (const double v : x) largest = std::max(largest, std::abs(v));
  if (!(largest > 0.0) || !std::isfinite(largest)) return 1.0;
  const double scale = std::ldexp(1.0, std::clamp(-std::ilogb(largest), -1022, 1022));
  for (double& v : x) v *= scale;
  return scale;
}

}  // namespace

MixedCholesky::MixedCholesky(const SparsePattern& lower, std::int32_t block)
    : lower_(lower), block_(block), single_(lower, block) {}

std::int64_t MixedCholesky::factorize(std::span<const double> values, int threads) {
  in_double_ = false;
  if (!beyond_single_ && single_.factorize(values, threads) < 0) return -1;
  return factorize_in_double(values, threads);
}

std::int64_t MixedCholesky::factorize_in_double(std::span<const double> values, int threads) {
  if (!double_) {
    double_ = std::make_unique<SupernodalCholesky<double>>(lower_, block_, single_.structure());
  }
  const std::int64_t failed = double_->factorize(values, threads);
  if (failed < 0) in_double_ = beyond_single_ = true;
  return failed;
}

void MixedCholesky::multiply(std::span<const double> values, std::span<const double> x,
                             std::span<double> y) const {
  std::fill(y.begin(), y.end(), 0.0);
  for (std::int32_t c = 0; c < lower_.cols; ++c) {
    double sum = 0.0;
    for (std::int32_t k = lower_.start[c]; k < lower_.start[c + 1]; ++k) {
      const std::int32_t r = lower_.row[k];
      sum += values[k] * x[r];
      if (r != c) y[r] += values[k] * x[c];
    }
    y[c] += sum;
  }
}

void MixedCholesky::solve(std::span<double> x, int threads) {
  if (in_double_) return double_->solve(x, threads);
  const double scale = normalize(x);
  single_.solve(x, threads);
  for (double& v : x) v /= scale;
}

void MixedCholesky::solve(std::span<std::vector<double>> x, int threads) {
  if (in_double_) return double_->solve(x, threads);
  std::vector<double> scales;
  for (std::vector<double>& side : x) scales.push_back(normalize(side));
  single_.solve(x, threads);
  for (std::size_t k = 0; k < x.size(); ++k) {
    for (double& v : x[k]) v /= scales[k];
  }
}

bool MixedCholesky::solve(std::span<double> x, std::span<const double> values, double rtol,
                          int threads) {
  if (in_double_) {
    double_->solve(x, threads);
    return true;
  }
  const std::vector<double> b(x.begin(), x.end());
  const double scale = normalize(x);
  const std::vector<double> scaled(x.begin(), x.end());
  std::fill(x.begin(), x.end(), 0.0);
  const auto product = [&](std::span<const double> p, std::span<double> of) {
    multiply(values, p, of);
  };
  const auto precondition = [&](std::span<const double> r, std::span<double> z) {
    std::copy(r.begin(), r.end(), z.begin());
    solve(z, threads);
  };
  const KrylovOptions options{.rtol = rtol, .max_iterations = kMostIterations, .threads = threads};
  try {
    if (cg(product, scaled, x, options, precondition).converged) {
      for (double& v : x) v /= scale;
      return true;
    }
  } catch (const NonFiniteError&) {  // beyond the range of float32
  }
  std::copy(b.begin(), b.end(), x.begin());
  const bool definite = factorize_in_double(values, threads) < 0;
  solve(x, threads);
  return definite;
}

}  // namespace substep
