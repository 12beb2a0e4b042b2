#include "substep/gridfluid/pressure_solver.h"

#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/core/lanes.h"

namespace substep::gridfluid {
namespace {

constexpr int kDoubles = kVectorBytes / 8;

// n numbers as doubles.
template <int kLanes, class Real>
SUBSTEP_INLINE Vector<double, kLanes * 8> doubles(const Real* from) {
  return __builtin_convertvector(load<Vector<Real, kLanes * int(sizeof(Real))>>(from),
                                 Vector<double, kLanes * 8>);
}
template <int kLanes, class Real>
SUBSTEP_INLINE void store(const Vector<double, kLanes * 8>& v, Real* to) {
  using Narrow = Vector<Real, kLanes * int(sizeof(Real))>;
  const Narrow narrow = __builtin_convertvector(v, Narrow);
  std::memcpy(to, &narrow, sizeof narrow);
}

// The sum of term<kLanes>(i), lanes of doubles, over [0, n).
template <class Term>
SUBSTEP_INLINE double sum_over(int n, const Term& term) {
  Vector<double, kDoubles * 8> sums{};
  int i = 0;
  for (; i + kDoubles <= n; i += kDoubles) sums += term.template operator()<kDoubles>(i);
  double sum = 0;
  for (int lane = 0; lane < kDoubles; ++lane) sum += sums[lane];
  for (; i < n; ++i) sum += term.template operator()<1>(i)[0];
  return sum;
}

// A x for lanes of cells from i on: the differences and their sum in double.
template <int kLanes, int D, class Real, class X>
SUBSTEP_INLINE Vector<double, kLanes * 8> product(
    const std::array<std::span<const Real>, std::size_t{D}>& w, const Row<D>& row, const X* x,
    int i) {
  using V = Vector<double, kLanes * 8>;
  const X* const here = x + row.at + i;
  const Real* const along = w[D - 1].data() + row.at + i;
  const V own = doubles<kLanes>(here);
  V sum = doubles<kLanes>(along) * (own - doubles<kLanes>(here - 1)) +
          doubles<kLanes>(along + 1) * (own - doubles<kLanes>(here + 1));
  for (std::size_t a = 0; a < D - 1; ++a) {
    sum += doubles<kLanes>(w[a].data() + row.at + i) *
               (own - doubles<kLanes>(x + row.below[a] + i)) +
           doubles<kLanes>(w[a].data() + row.above[a] + i) *
               (own - doubles<kLanes>(x + row.above[a] + i));
  }
  return sum;
}

}  // namespace

template <class Real, int D>
PressureSolver<Real, D>::PressureSolver(const Layout<D>& layout)
    : layout_(layout), multigrid_(layout) {
  for (AlignedBuffer<Real>* v : {&r_, &z_, &d_, &q_}) {
    v->reset(usize(layout.size));
    std::fill(v->begin(), v->end(), Real(0));
  }
  parts_.resize(usize(layout.cells[0]));
}

template <class Real, int D>
std::size_t PressureSolver<Real, D>::bytes() const {
  return r_.bytes() + z_.bytes() + d_.bytes() + q_.bytes() + multigrid_.bytes() + regions_.bytes();
}

template <class Real, int D>
void PressureSolver<Real, D>::set_matrix(const Coefficients& w, std::span<const Cell> cells,
                                         int threads) {
  w_ = w;
  multigrid_.set_matrix(w, cells, threads);
  regions_.find(layout_, w, cells, threads);
}

// The sum of use(row) over all rows, in their order.
template <class Real, int D>
template <class Row_, class Use>
double PressureSolver<Real, D>::sum_rows(const Use& use, int threads) {
  for_slabs(
      layout_,
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k) {
          double sum = 0;
          for_rows(layout_, k, [&](const Row_& row) { sum += use(row); });
          parts_[usize(k)] = sum;
        }
      },
      threads);
  double sum = 0;
  for (const double part : parts_) sum += part;
  return sum;
}

// r -= A p; returns |r|^2.
template <class Real, int D>
double PressureSolver<Real, D>::find_residual(std::span<const double> p, int threads) {
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  return sum_rows<Row<D>>(
      [&](const Row<D>& row) {
        Real* const r = r_.data() + row.at;
        return sum_over(row.length, [&]<int kLanes>(int i) {
          using V = Vector<double, kLanes * 8>;
          const V v = doubles<kLanes>(r + i) - product<kLanes, D>(w_, row, p.data(), i);
          const V masked = doubles<kLanes>(inverse + row.at + i) > 0 ? v : V{};
          store<kLanes>(masked, r + i);
          return V(masked * masked);
        });
      },
      threads);
}

// d = z + beta d and q = A d; returns d . q.
template <class Real, int D>
double PressureSolver<Real, D>::apply(Real beta, int threads) {
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  for_planes_in_stages<2>(
      layout_,
      [&](int stage, int plane) {
        double sum = 0;
        for_rows(layout_, plane, [&](const Row<D>& row) {
          Real *const d = d_.data() + row.at, *const q = q_.data() + row.at;
          if (stage == 0) {
            const Real* const z = z_.data() + row.at;
            for (int i = 0; i < row.length; ++i) d[i] = z[i] + beta * d[i];
            wrap_row(layout_, row, d_.data());
          } else {
            sum += sum_over(row.length, [&]<int kLanes>(int i) {
              using V = Vector<double, kLanes * 8>;
              const V v = product<kLanes, D>(w_, row, d_.data(), i);
              const V masked = doubles<kLanes>(inverse + row.at + i) > 0 ? v : V{};
              store<kLanes>(masked, q + i);
              return V(masked * doubles<kLanes>(d + i));
            });
          }
        });
        if (stage == 1) parts_[usize(plane)] = sum;
      },
      threads);
  double sum = 0;
  for (const double part : parts_) sum += part;
  return sum;
}

// Conjugate gradients from r on, until |r| <= goal or it stalls; whether it did not.
template <class Real, int D>
bool PressureSolver<Real, D>::iterate(std::span<double> p, double goal, int max_iterations,
                                      SolveReport& report, int threads) {
  constexpr int kPatience = 10;  // iterations in which the residual must have halved
  const bool with_multigrid = report.preconditioner == Preconditioner::kMultigrid;
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  double rz = 0, best = report.residual;
  int since = 0;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    poll_interrupt();
    regions_.remove_means(std::span<Real>(r_.data(), r_.size()), threads);
    if (with_multigrid) multigrid_.precondition({r_.data(), r_.size()}, {z_.data(), z_.size()}, threads);
    const double before = rz;
    rz = sum_rows<Row<D>>(
        [&](const Row<D>& row) {
          const Real* const r = r_.data() + row.at;
          Real* const z = z_.data() + row.at;
          if (!with_multigrid) {
            for (int i = 0; i < row.length; ++i) z[i] = r[i] * inverse[row.at + i];
            wrap_row(layout_, row, z_.data());
          }
          return sum_over(row.length, [&]<int kLanes>(int i) {
            return Vector<double, kLanes * 8>(doubles<kLanes>(r + i) * doubles<kLanes>(z + i));
          });
        },
        threads);
    const double dq = apply(iteration == 0 ? Real(0) : static_cast<Real>(rz / before), threads);
    if (!(rz > 0) || !(dq > 0) || !std::isfinite(rz / dq)) return false;
    const double alpha = rz / dq;
    const double rr = sum_rows<Row<D>>(
        [&](const Row<D>& row) {
          Real* const r = r_.data() + row.at;
          const Real *const d = d_.data() + row.at, *const q = q_.data() + row.at;
          double* const x = p.data() + row.at;
          return sum_over(row.length, [&]<int kLanes>(int i) {
            using V = Vector<double, kLanes * 8>;
            store<kLanes>(V(doubles<kLanes>(x + i) + alpha * doubles<kLanes>(d + i)), x + i);
            const V v = doubles<kLanes>(r + i) - alpha * doubles<kLanes>(q + i);
            store<kLanes>(v, r + i);
            return V(v * v);
          });
        },
        threads);
    ++report.iterations;
    report.residual = std::sqrt(rr);
    if (report.residual <= goal) return true;
    if (!std::isfinite(report.residual)) return false;
    if (report.residual < 0.5 * best) {
      best = report.residual, since = 0;
    } else if (++since >= kPatience && with_multigrid) {
      return false;
    }
  }
  return true;
}

template <class Real, int D>
SolveReport PressureSolver<Real, D>::solve(std::span<const Real> b, std::span<double> p,
                                           double tolerance, int max_iterations, int threads) {
  SolveReport report;
  report.closed_regions = regions_.count();
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  const auto start = [&] {
    return sum_rows<Row<D>>(
        [&](const Row<D>& row) {
          double sum = 0;
          Real* const r = r_.data() + row.at;
          for (int i = 0; i < row.length; ++i) {
            const auto at = usize(row.at + i);
            r[i] = inverse[at] > 0 ? b[at] : 0;
            sum += std::abs(double(r[i]));
          }
          return sum;
        },
        threads);
  };
  const double sum = start();
  const double imbalance = regions_.remove_means(std::span<Real>(r_.data(), r_.size()), threads);
  report.imbalance = sum > 0 ? imbalance / sum : 0;
  // |b|, and p = 0 where it is not to be found.
  const double bb = sum_rows<Row<D>>(
      [&](const Row<D>& row) {
        double* const x = p.data() + row.at;
        Real* const r = r_.data() + row.at;
        for (int i = 0; i < row.length; ++i) x[i] = inverse[row.at + i] > 0 ? x[i] : 0;
        wrap_row(layout_, row, p.data());
        return sum_over(row.length, [&]<int kLanes>(int i) {
          const auto v = doubles<kLanes>(r + i);
          return Vector<double, kLanes * 8>(v * v);
        });
      },
      threads);
  const double norm = std::sqrt(bb), goal = tolerance * norm;
  report.residual = std::sqrt(find_residual(p, threads));
  report.converged = report.residual <= goal;
  if (!report.converged) {
    if (!iterate(p, goal, max_iterations, report, threads)) {
      report.preconditioner = Preconditioner::kDiagonal;
    }
    report.converged = report.residual <= goal;
  }
  report.residual = norm > 0 ? report.residual / norm : 0;
  regions_.remove_means(p, threads);
  return report;
}

template class PressureSolver<float, 2>;
template class PressureSolver<float, 3>;
template class PressureSolver<double, 2>;
template class PressureSolver<double, 3>;

}  // namespace substep::gridfluid
