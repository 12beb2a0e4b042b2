#include "substep/linalg/direct/cholesky.h"

#include <algorithm>
#include <cmath>
#include <mutex>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/cholmod_common.h"
#include "substep/linalg/direct/library_calls.h"
#include "substep/linalg/direct/ordering.h"
#include "substep/linalg/finite.h"

namespace substep {
namespace {

// Below this many operations per nonzero of L the columns are too thin for dense blocks to pay.
constexpr double kSupernodalFlopsPerEntry = 40;

struct FreeFactor {
  CholmodCommon* common;
  void operator()(cholmod_factor* factor) const { cholmod_free_factor(&factor, common); }
};
using Factor = std::unique_ptr<cholmod_factor, FreeFactor>;

cholmod_dense dense_view(double* x, std::size_t rows, std::size_t columns) {
  cholmod_dense view{};
  view.nrow = view.d = rows;
  view.ncol = columns;
  view.nzmax = rows * columns;
  view.x = x;
  view.xtype = CHOLMOD_REAL;
  view.dtype = CHOLMOD_DOUBLE;
  return view;
}

}  // namespace

struct Cholesky::Impl {
  Impl(SparsePattern lower, const CholeskyOptions& options_)
      : pattern(std::move(lower)), options(options_), factor(nullptr, FreeFactor{&common}) {
    check_pattern(pattern);
    if (pattern.rows != pattern.cols) throw InputError("pattern: expected a square matrix");
    if (!is_lower(pattern)) throw InputError("pattern: expected the lower triangle only");
    if (options.block < 1 || pattern.rows % options.block != 0) {
      throw InputError("block: expected a divisor of the number of rows");
    }
    if (options.kind == CholeskyKind::supernodal && !SUBSTEP_GPL) {
      throw InputError("kind: this build has no supernodal factorization (SUBSTEP_GPL=OFF)");
    }
    if (pattern.rows > 0) analyze();
  }

  ~Impl() {
    cholmod_free_dense(&solution, &common);
    cholmod_free_dense(&work_y, &common);
    cholmod_free_dense(&work_e, &common);
  }

  void analyze();
  Factor analyze(Ordering ordering);

  SparsePattern pattern;
  CholeskyOptions options;
  CholeskyReport report;
  CholmodCommon common;
  Factor factor;
  cholmod_dense *solution = nullptr, *work_y = nullptr, *work_e = nullptr;  // of solve, kept
  std::mutex mutex;  // CHOLMOD's workspace serves one thread
};

Factor Cholesky::Impl::analyze(Ordering ordering) {
  std::vector<std::int32_t> order = elimination_order(pattern, ordering, options.block);
  const LibraryCalls guard;
  common.nmethods = 1;
  common.method[0].ordering = CHOLMOD_GIVEN;
  common.postorder = 1;
  common.quick_return_if_not_posdef = 1;
  common.final_ll = 1;
  common.supernodal_switch = kSupernodalFlopsPerEntry;
  common.supernodal = !SUBSTEP_GPL || options.kind == CholeskyKind::simplicial ? CHOLMOD_SIMPLICIAL
                      : options.kind == CholeskyKind::supernodal               ? CHOLMOD_SUPERNODAL
                                                                               : CHOLMOD_AUTO;
  cholmod_sparse a = cholmod_lower(pattern, nullptr);
  Factor result(cholmod_analyze_p(&a, order.data(), nullptr, 0, &common), FreeFactor{&common});
  common.throw_if_out_of_memory();
  if (!result) throw InputError("pattern: CHOLMOD could not analyse it");
  return result;
}

void Cholesky::Impl::analyze() {
  const Ordering ordering =
      options.ordering == Ordering::automatic ? Ordering::amd : options.ordering;
  factor = analyze(ordering);
  report.ordering = ordering;
  report.supernodal = factor->is_super;
  report.factor_entries = common.lnz;
  report.flops = common.fl;
  ++report.analyses;
}

Cholesky::Cholesky(SparsePattern lower, const CholeskyOptions& options)
    : impl_(std::make_unique<Impl>(std::move(lower), options)) {}
Cholesky::Cholesky(Cholesky&&) noexcept = default;
Cholesky& Cholesky::operator=(Cholesky&&) noexcept = default;
Cholesky::~Cholesky() = default;

const CholeskyReport& Cholesky::report() const { return impl_->report; }
const SparsePattern& Cholesky::pattern() const { return impl_->pattern; }

const CholeskyReport& Cholesky::factor(std::span<const double> values) {
  Impl& my = *impl_;
  const std::scoped_lock lock(my.mutex);
  CholeskyReport& report = my.report;
  if (values.size() != my.pattern.row.size()) {
    throw InputError("values: expected " + std::to_string(my.pattern.row.size()) +
                     " numbers, one per entry of the pattern, got " +
                     std::to_string(values.size()));
  }
  check_finite(my.pattern, values);
  report.factorized = my.pattern.rows == 0;
  report.column = -1;
  if (report.factorized) return report;
  if (!my.factor) my.analyze();  // memory had run out
  const LibraryCalls guard;
  cholmod_sparse a = cholmod_lower(my.pattern, values.data());
  cholmod_factorize(&a, my.factor.get(), &my.common);
  if (my.common.status < 0) {
    my.factor.reset();
    throw std::bad_alloc();
  }
  ++report.factorizations;
  if (my.common.status == CHOLMOD_NOT_POSDEF || my.factor->minor < my.factor->n) {
    report.column = static_cast<const std::int32_t*>(my.factor->Perm)[my.factor->minor];
  } else {
    report.factorized = true;
  }
  return report;
}

void Cholesky::solve(std::span<const double> b, std::span<double> x, std::int32_t columns) {
  Impl& my = *impl_;
  const std::scoped_lock lock(my.mutex);
  if (!my.report.factorized) {
    const std::int32_t column = my.report.column;
    throw SingularMatrixError(
        column < 0 ? "the matrix has not been factorized"
                   : "the matrix is not positive definite (row " + std::to_string(column) + ")",
        std::nan(""), column);
  }
  const auto n = usize(my.pattern.rows);
  const auto count = usize(columns);
  if (columns < 0 || b.size() != n * count || x.size() != n * count) {
    throw InputError("b: expected " + std::to_string(n) + " numbers per right-hand side");
  }
  if (n == 0 || count == 0) return;
  const LibraryCalls guard;
  cholmod_dense right = dense_view(const_cast<double*>(b.data()), n, count);
  if (!cholmod_solve2(CHOLMOD_A, my.factor.get(), &right, nullptr, &my.solution, nullptr,
                      &my.work_y, &my.work_e, &my.common)) {
    throw std::bad_alloc();
  }
  const auto* const from = static_cast<const double*>(my.solution->x);
  std::copy(from, from + n * count, x.begin());
}

}  // namespace substep
