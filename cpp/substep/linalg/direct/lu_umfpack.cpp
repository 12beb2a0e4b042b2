#if SUBSTEP_GPL
#include <umfpack.h>

#include <array>
#include <cmath>
#include <new>
#include <type_traits>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/lu_library.h"

namespace substep {
namespace {

constexpr bool failed(int status) { return status < 0; }

[[noreturn]] void fail(int status) {
  if (status == UMFPACK_ERROR_out_of_memory) throw std::bad_alloc();
  throw SolverError("UMFPACK failed with status " + std::to_string(status));
}

// UMFPACK's functions for real numbers and, with real and imaginary parts in turn, for complex.
template <class T>
struct Umfpack;

template <>
struct Umfpack<double> {
  static constexpr auto defaults = umfpack_di_defaults;
  static constexpr auto free_symbolic = umfpack_di_free_symbolic;
  static constexpr auto free_numeric = umfpack_di_free_numeric;
  static constexpr std::size_t kWork = 1;  // doubles per unknown in solve
  static int symbolic(int n, const int* p, const int* i, void** out, const double* control) {
    return umfpack_di_symbolic(n, n, p, i, nullptr, out, control, nullptr);
  }
  static int numeric(const int* p, const int* i, const double* x, void* symbolic, void** out,
                     const double* control, double* info) {
    return umfpack_di_numeric(p, i, x, symbolic, out, control, info);
  }
  static int pivots(int* rows, double* diagonal, void* numeric) {
    int scaled;
    return umfpack_di_get_numeric(nullptr, nullptr, nullptr, nullptr, nullptr, nullptr, rows,
                                  nullptr, diagonal, &scaled, nullptr, numeric);
  }
  static int solve(bool transpose, double* x, const double* b, void* numeric, const double* control,
                   int* wi, double* w) {
    double info[UMFPACK_INFO];
    return umfpack_di_wsolve(transpose ? UMFPACK_Aat : UMFPACK_A, nullptr, nullptr, nullptr, x, b,
                             numeric, control, info, wi, w);
  }
};

template <>
struct Umfpack<std::complex<double>> {
  using Complex = std::complex<double>;
  static constexpr auto defaults = umfpack_zi_defaults;
  static constexpr auto free_symbolic = umfpack_zi_free_symbolic;
  static constexpr auto free_numeric = umfpack_zi_free_numeric;
  static constexpr std::size_t kWork = 4;
  static const double* parts(const Complex* x) { return reinterpret_cast<const double*>(x); }
  static double* parts(Complex* x) { return reinterpret_cast<double*>(x); }
  static int symbolic(int n, const int* p, const int* i, void** out, const double* control) {
    return umfpack_zi_symbolic(n, n, p, i, nullptr, nullptr, out, control, nullptr);
  }
  static int numeric(const int* p, const int* i, const Complex* x, void* symbolic, void** out,
                     const double* control, double* info) {
    return umfpack_zi_numeric(p, i, parts(x), nullptr, symbolic, out, control, info);
  }
  static int pivots(int* rows, Complex* diagonal, void* numeric) {
    int scaled;
    return umfpack_zi_get_numeric(nullptr, nullptr, nullptr, nullptr, nullptr, nullptr, nullptr,
                                  nullptr, rows, nullptr, parts(diagonal), nullptr, &scaled,
                                  nullptr, numeric);
  }
  static int solve(bool transpose, Complex* x, const Complex* b, void* numeric,
                   const double* control, int* wi, double* w) {
    double info[UMFPACK_INFO];
    return umfpack_zi_wsolve(transpose ? UMFPACK_Aat : UMFPACK_A, nullptr, nullptr, nullptr,
                             nullptr, parts(x), nullptr, parts(b), nullptr, numeric, control, info,
                             wi, w);
  }
};

template <class T>
class UmfpackLU : public LULibrary<T> {
  using Api = Umfpack<T>;

 public:
  explicit UmfpackLU(const SparsePattern& pattern)
      : pattern_(pattern), rows_(usize(pattern.rows)), work_(rows_.size() * Api::kWork) {
    Api::defaults(control_.data());
    control_[UMFPACK_PRL] = 0;
    control_[UMFPACK_IRSTEP] = 0;  // the residual is the caller's business
    const int status = Api::symbolic(pattern.rows, pattern.start.data(), pattern.row.data(),
                                     &symbolic_, control_.data());
    if (failed(status)) fail(status);
  }
  ~UmfpackLU() override {
    Api::free_numeric(&numeric_);
    Api::free_symbolic(&symbolic_);
  }

  std::int32_t factor(std::span<const T> values, LUReport& report) override {
    Api::free_numeric(&numeric_);
    std::array<double, UMFPACK_INFO> info{};
    const int status = Api::numeric(pattern_.start.data(), pattern_.row.data(), values.data(),
                                    symbolic_, &numeric_, control_.data(), info.data());
    if (failed(status)) fail(status);
    report.factor_entries = info[UMFPACK_LNZ] + info[UMFPACK_UNZ];
    report.rcond = info[UMFPACK_RCOND];
    return status == UMFPACK_WARNING_singular_matrix || !(report.rcond > 0) ? singular_row() : -1;
  }

  void solve(const T* b, T* x, bool transpose) override {
    const int status =
        Api::solve(transpose, x, b, numeric_, control_.data(), rows_.data(), work_.data());
    if (failed(status)) fail(status);
  }

 private:
  std::int32_t singular_row() {
    std::vector<T> diagonal(rows_.size());
    Api::pivots(rows_.data(), diagonal.data(), numeric_);
    for (std::size_t k = 0; k < diagonal.size(); ++k) {
      const double size = std::abs(diagonal[k]);
      if (!(size > 0) || !std::isfinite(size)) return rows_[k];
    }
    return 0;
  }

  const SparsePattern& pattern_;
  std::array<double, UMFPACK_CONTROL> control_{};
  void *symbolic_ = nullptr, *numeric_ = nullptr;
  std::vector<int> rows_;
  std::vector<double> work_;
};

}  // namespace

template <class T>
std::unique_ptr<LULibrary<T>> make_umfpack(const SparsePattern& pattern) {
  return std::make_unique<UmfpackLU<T>>(pattern);
}
template std::unique_ptr<LULibrary<double>> make_umfpack(const SparsePattern&);
template std::unique_ptr<LULibrary<std::complex<double>>> make_umfpack(const SparsePattern&);

}  // namespace substep
#endif
