#include "substep/springs/limited_memory.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/linalg/vectors.h"

namespace substep::springs {
namespace {

// The cosine between s and y below which their product is rounding.
constexpr double kLeastCosine = 1e-10;

// a - b, as one list of numbers.
void subtract(Positions a, Positions b, std::vector<double>& difference, int threads) {
  difference.resize(3 * a.size());
  for_each_index(a.size(), threads, [&](std::size_t i) {
    for (int c = 0; c < 3; ++c) difference[3 * i + usize(c)] = a[i][c] - b[i][c];
  });
}

// r += a v
void add_scaled(std::span<double> r, double a, std::span<const double> v, int threads) {
  for_each_index(r.size(), threads, [&](std::size_t i) { r[i] += a * v[i]; });
}

}  // namespace

void LimitedMemory::forget(std::size_t kept) {
  if (pairs_.size() > kept)
    pairs_.erase(pairs_.begin(), pairs_.end() - static_cast<std::ptrdiff_t>(kept));
}

void LimitedMemory::add(Positions x_before, Positions x, Positions g_before, Positions g,
                        int threads) {
  Pair pair;
  if (pairs_.size() == capacity_) {  // its memory is used again
    pair = std::move(pairs_.front());
    pairs_.erase(pairs_.begin());
  }
  subtract(x, x_before, pair.s, threads);
  subtract(g, g_before, pair.y, threads);
  const double product = dot(pair.s, pair.y, threads);
  const double lengths = norm2<double>(pair.s, threads) * norm2<double>(pair.y, threads);
  if (!(product > kLeastCosine * lengths)) return;
  pair.rho = 1.0 / product;
  pairs_.push_back(std::move(pair));
}

void LimitedMemory::multiply(std::span<Vec3> r, const std::function<void(std::span<double>)>& solve,
                             int threads) const {
  if (r.empty()) return;
  const std::span<double> q(r[0].data(), 3 * r.size());
  std::vector<double> a(pairs_.size());
  for (std::size_t j = pairs_.size(); j-- > 0;) {
    a[j] = pairs_[j].rho * dot(pairs_[j].s, q, threads);
    add_scaled(q, -a[j], pairs_[j].y, threads);
  }
  solve(q);
  for (std::size_t j = 0; j < pairs_.size(); ++j) {
    const double b = pairs_[j].rho * dot(pairs_[j].y, q, threads);
    add_scaled(q, a[j] - b, pairs_[j].s, threads);
  }
}

}  // namespace substep::springs
