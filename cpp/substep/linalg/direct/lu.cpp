#include "substep/linalg/direct/lu.h"

#include <amd.h>

#include <algorithm>
#include <cmath>
#include <mutex>
#include <new>
#include <string>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/library_calls.h"
#include "substep/linalg/direct/lu_library.h"
#include "substep/linalg/finite.h"

namespace substep {
namespace {

#if SUBSTEP_GPL
// Measured (docs/linalg.md): KLU is up to six times as quick on chains and circuits and 1.5 times
// on a mesh of 32^2, the same at 64^2, and slower above. What tells is how many operations a
// nonzero of the factor of A + A^T costs in AMD's order: below this many, KLU.
constexpr double kKluFlopsPerEntry = 60;

LUKind choose(const SparsePattern& pattern, LUKind kind) {
  if (kind != LUKind::automatic) return kind;
  const FactorCost cost = factor_cost(pattern);
  return cost.operations <= kKluFlopsPerEntry * cost.entries ? LUKind::klu : LUKind::umfpack;
}
#else
LUKind choose(const SparsePattern&, LUKind kind) {
  if (kind == LUKind::umfpack) {
    throw InputError("kind: this build has no UMFPACK (SUBSTEP_GPL=OFF)");
  }
  return LUKind::klu;
}
#endif

template <class T>
std::unique_ptr<LULibrary<T>> make_library(const SparsePattern& pattern, LUKind kind) {
#if SUBSTEP_GPL
  if (kind == LUKind::umfpack) return make_umfpack<T>(pattern);
#endif
  return kind == LUKind::klu ? make_klu<T>(pattern) : nullptr;
}

}  // namespace

FactorCost factor_cost(const SparsePattern& pattern) {
  if (pattern.rows == 0) return {};
  std::vector<std::int32_t> order(usize(pattern.rows));
  double info[AMD_INFO];
  const int status = amd_order(pattern.rows, pattern.start.data(), pattern.row.data(), order.data(),
                               nullptr, info);
  if (status == AMD_OUT_OF_MEMORY) throw std::bad_alloc();
  return {info[AMD_NDIV] + 2 * info[AMD_NMULTSUBS_LDL], info[AMD_LNZ] + pattern.rows};
}

template <class T>
struct LU<T>::Impl {
  Impl(SparsePattern pattern_, LUKind kind) : pattern(std::move(pattern_)) {
    check_pattern(pattern);
    if (pattern.rows != pattern.cols) throw InputError("pattern: expected a square matrix");
    report.kind = choose(pattern, kind);
    if (pattern.row.empty()) return;
    const LibraryCalls guard;
    library = make_library<T>(pattern, report.kind);
    ++report.analyses;
  }

  SparsePattern pattern;
  LUReport report;
  std::unique_ptr<LULibrary<T>> library;  // none where there are no entries
  std::vector<T> right, result;           // of solve, kept
  std::mutex mutex;                       // the library's workspace serves one thread
};

template <class T>
LU<T>::LU(SparsePattern pattern, LUKind kind)
    : impl_(std::make_unique<Impl>(std::move(pattern), kind)) {}
template <class T>
LU<T>::LU(LU&&) noexcept = default;
template <class T>
LU<T>& LU<T>::operator=(LU&&) noexcept = default;
template <class T>
LU<T>::~LU() = default;

template <class T>
const LUReport& LU<T>::report() const {
  return impl_->report;
}
template <class T>
const SparsePattern& LU<T>::pattern() const {
  return impl_->pattern;
}

template <class T>
const LUReport& LU<T>::factor(std::span<const T> values) {
  Impl& my = *impl_;
  const std::scoped_lock lock(my.mutex);
  if (values.size() != my.pattern.row.size()) {
    throw InputError("values: expected " + std::to_string(my.pattern.row.size()) +
                     " numbers, one per entry of the pattern, got " +
                     std::to_string(values.size()));
  }
  check_finite(my.pattern, values);
  my.report.factorized = false;
  std::int32_t singular = my.pattern.rows > 0 ? 0 : -1;
  if (my.library) {
    const LibraryCalls guard;
    singular = my.library->factor(values, my.report);
  }
  if (singular >= 0) {
    throw SingularMatrixError("the matrix is singular at row " + std::to_string(singular),
                              std::nan(""), singular);
  }
  ++my.report.factorizations;
  my.report.factorized = true;
  return my.report;
}

template <class T>
void LU<T>::solve(std::span<const T> b, std::span<T> x, std::int32_t columns, bool transpose) {
  Impl& my = *impl_;
  const std::scoped_lock lock(my.mutex);
  if (!my.report.factorized) throw SingularMatrixError("the matrix has not been factorized");
  const auto n = usize(my.pattern.rows);
  const auto count = usize(columns);
  if (columns < 0 || b.size() != n * count || x.size() != n * count) {
    throw InputError("b: expected " + std::to_string(n) + " numbers per right-hand side");
  }
  if (n == 0 || count == 0) return;
  my.right.resize(n);
  my.result.resize(n);
  const LibraryCalls guard;
  for (std::size_t c = 0; c < count; ++c) {
    std::copy_n(b.begin() + static_cast<std::ptrdiff_t>(c * n), n, my.right.begin());
    my.library->solve(my.right.data(), my.result.data(), transpose);
    std::copy(my.result.begin(), my.result.end(), x.begin() + static_cast<std::ptrdiff_t>(c * n));
  }
}

template class LU<double>;
template class LU<std::complex<double>>;

}  // namespace substep
