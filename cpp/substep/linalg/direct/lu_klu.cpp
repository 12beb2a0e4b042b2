#include <klu.h>

#include <algorithm>
#include <new>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/lu_library.h"

namespace substep {
namespace {

// KLU's functions for real numbers and, with real and imaginary parts in turn, for complex.
template <class T>
struct Klu;

template <>
struct Klu<double> {
  static constexpr auto free_numeric = klu_free_numeric;
  static constexpr auto rcond = klu_rcond;
  static klu_numeric* factor(int* p, int* i, const double* x, klu_symbolic* symbolic,
                             klu_common* common) {
    return klu_factor(p, i, const_cast<double*>(x), symbolic, common);
  }
  static int solve(bool transpose, klu_symbolic* symbolic, klu_numeric* numeric, int n, double* x,
                   klu_common* common) {
    return (transpose ? klu_tsolve : klu_solve)(symbolic, numeric, n, 1, x, common);
  }
};

template <>
struct Klu<std::complex<double>> {
  using Complex = std::complex<double>;
  static constexpr auto free_numeric = klu_z_free_numeric;
  static constexpr auto rcond = klu_z_rcond;
  static klu_numeric* factor(int* p, int* i, const Complex* x, klu_symbolic* symbolic,
                             klu_common* common) {
    return klu_z_factor(p, i, const_cast<double*>(reinterpret_cast<const double*>(x)), symbolic,
                        common);
  }
  static int solve(bool transpose, klu_symbolic* symbolic, klu_numeric* numeric, int n, Complex* x,
                   klu_common* common) {
    auto* const parts = reinterpret_cast<double*>(x);
    return transpose ? klu_z_tsolve(symbolic, numeric, n, 1, parts, 0, common)
                     : klu_z_solve(symbolic, numeric, n, 1, parts, common);
  }
};

template <class T>
class KluLU : public LULibrary<T> {
 public:
  explicit KluLU(const SparsePattern& pattern) : pattern_(pattern) {
    klu_defaults(&common_);
    symbolic_ = klu_analyze(pattern.rows, start(), row(), &common_);
    if (!symbolic_ && common_.status != KLU_SINGULAR) fail();
  }
  ~KluLU() override {
    Klu<T>::free_numeric(&numeric_, &common_);
    klu_free_symbolic(&symbolic_, &common_);
  }

  // Always with a new choice of pivots (not klu_refactor), so that the bits do not depend on the
  // matrices that came before.
  std::int32_t factor(std::span<const T> values, LUReport& report) override {
    Klu<T>::free_numeric(&numeric_, &common_);
    if (!symbolic_) return singular_row(values);
    numeric_ = Klu<T>::factor(start(), row(), values.data(), symbolic_, &common_);
    if (common_.status == KLU_SINGULAR) return singular_row(values);
    if (!numeric_) fail();
    report.factor_entries = static_cast<double>(numeric_->lnz) + numeric_->unz;
    Klu<T>::rcond(symbolic_, numeric_, &common_);
    report.rcond = common_.rcond;
    return -1;
  }

  void solve(const T* b, T* x, bool transpose) override {
    std::copy(b, b + pattern_.rows, x);
    if (!Klu<T>::solve(transpose, symbolic_, numeric_, pattern_.rows, x, &common_)) fail();
  }

 private:
  int* start() const { return const_cast<int*>(pattern_.start.data()); }
  int* row() const { return const_cast<int*>(pattern_.row.data()); }

  [[noreturn]] void fail() const {
    if (common_.status == KLU_OUT_OF_MEMORY || common_.status == KLU_TOO_LARGE) {
      throw std::bad_alloc();
    }
    throw SolverError("KLU failed with status " + std::to_string(common_.status));
  }

  // KLU stops at the column that has no pivot left. A row of zeros is named where there is one.
  std::int32_t singular_row(std::span<const T> values) const {
    std::vector<bool> empty(usize(pattern_.rows), true);
    for (std::size_t k = 0; k < values.size(); ++k) {
      if (values[k] != T{}) empty[usize(pattern_.row[k])] = false;
    }
    const auto row = std::find(empty.begin(), empty.end(), true);
    if (row != empty.end()) return static_cast<std::int32_t>(row - empty.begin());
    return std::clamp(common_.singular_col, 0, pattern_.cols - 1);
  }

  const SparsePattern& pattern_;
  klu_common common_{};
  klu_symbolic* symbolic_ = nullptr;
  klu_numeric* numeric_ = nullptr;
};

}  // namespace

template <class T>
std::unique_ptr<LULibrary<T>> make_klu(const SparsePattern& pattern) {
  return std::make_unique<KluLU<T>>(pattern);
}
template std::unique_ptr<LULibrary<double>> make_klu(const SparsePattern&);
template std::unique_ptr<LULibrary<std::complex<double>>> make_klu(const SparsePattern&);

}  // namespace substep
