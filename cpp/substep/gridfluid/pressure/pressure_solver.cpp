#include "substep/gridfluid/pressure/pressure_solver.h"

#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/pressure/row_product.h"

namespace substep::gridfluid {
namespace {

constexpr int kDiagonalIterations = 20;  // at most, times the cells along all axes

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
  return r_.bytes() + z_.bytes() + d_.bytes() + q_.bytes() + rest_.bytes() + multigrid_.bytes() +
         regions_.bytes();
}

template <class Real, int D>
void PressureSolver<Real, D>::set_matrix(const Coefficients& w, std::span<const Cell> cells,
                                         int threads) {
  w_ = w;
  multigrid_.set_matrix(w, cells, threads);
  for (AlignedBuffer<Real>* v : {&r_, &z_, &d_, &q_}) fluid().clear(v->data(), threads);
  regions_.find(fluid(), w, cells, threads);
}

// The sum of use(row) over all rows, in their order.
template <class Real, int D>
template <class Use>
double PressureSolver<Real, D>::sum_rows(const Use& use, int threads) {
  for_slabs(
      fluid(),
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k) {
          double sum = 0;
          for_rows(fluid(), k, [&](const Row<D>& row) { sum += use(row); });
          parts_[usize(k)] = sum;
        }
      },
      threads);
  return sum_parts();
}

template <class Real, int D>
double PressureSolver<Real, D>::sum_parts() const {
  double sum = 0;
  for (const double part : parts_) sum += part;
  return sum;
}

// p = 0 where it is not to be found, or everywhere.
template <class Real, int D>
void PressureSolver<Real, D>::clear(std::span<double> p, bool keep, int threads) {
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  const std::int64_t rows = layout_.rows();
  // Between the fluid of a row and that of the next one.
  const auto begin_of = [&](std::int64_t r) {
    return r == rows ? layout_.size : layout_.row(r) + fluid().part(r).begin;
  };
  const auto end_of = [&](std::int64_t r) {
    return r < 0 ? 0 : layout_.row(r) + fluid().part(r).end;
  };
  parallel_for(
      rows + 1, 64,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t r = begin; r < end; ++r) {
          std::fill(p.data() + end_of(r - 1), p.data() + begin_of(r), 0.0);
          for (std::int64_t i = begin_of(r); r < rows && i < end_of(r); ++i)
            p[usize(i)] = keep && inverse[i] > 0 ? p[usize(i)] : 0;
        }
      },
      threads);
  for (int k = 0; k < layout_.cells[0] && layout_.periodic[D - 1]; ++k)
    for_rows(fluid(), k, [&](const Row<D>& row) { wrap_row(layout_, row, p.data()); });
}

// The sum of term(r_i), and |r|.
template <class Real, int D>
template <class Term>
double PressureSolver<Real, D>::sum_of(const Term& term, int threads) {
  return sum_rows(
      [&](const Row<D>& row) {
        const Real* const r = r_.data() + row.at;
        return sum_over(row.length,
                        [&]<int kLanes>(int i) { return term(doubles<kLanes>(r + i)); });
      },
      threads);
}

template <class Real, int D>
double PressureSolver<Real, D>::norm_of_r(int threads) {
  return std::sqrt(sum_of([](const auto& v) { return v * v; }, threads));
}

// r = b where there is fluid, without its means over the closed regions; returns |r|.
template <class Real, int D>
double PressureSolver<Real, D>::set_right_side(std::span<const Real> b, SolveReport& report,
                                               int threads) {
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  for_slabs(
      fluid(),
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k)
          for_rows(fluid(), k, [&](const Row<D>& row) {
            for (std::int64_t i = row.at; i < row.at + row.length; ++i)
              r_[usize(i)] = inverse[i] > 0 ? b[usize(i)] : 0;
          });
      },
      threads);
  if (regions_.count() > 0) {
    const double sum = sum_of([](const auto& v) { return v < 0 ? -v : v; }, threads);
    const double largest = regions_.remove_means(std::span(r_.data(), r_.size()), threads);
    report.imbalance = sum > 0 ? largest / sum : 0;
  }
  return norm_of_r(threads);
}

// r -= A p; returns |r|.
template <class Real, int D>
double PressureSolver<Real, D>::subtract_product(std::span<const double> p, int threads) {
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  const double norm = std::sqrt(sum_rows(
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
      threads));
  if (!bodies_) return norm;
  bodies_->add_product(Real(-1), p, std::span(r_.data(), r_.size()), threads);
  return norm_of_r(threads);
}

// z = M r; returns r . z.
template <class Real, int D>
double PressureSolver<Real, D>::precondition(Preconditioner preconditioner, int threads) {
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  const bool diagonal = preconditioner == Preconditioner::kDiagonal;
  const auto all = [](AlignedBuffer<Real>& v) { return std::span(v.data(), v.size()); };
  if (!diagonal && bodies_) {  // see Bodies
    rest_.reset(r_.size());
    copy(r_, rest_, threads);
    const auto kept = bodies_->take_moved(all(rest_), threads);
    regions_.remove_means(all(rest_), threads);
    multigrid_.precondition(all(rest_), all(z_), all(q_), threads);
    bodies_->add_moved(kept, all(z_), threads);
  } else if (!diagonal) {
    multigrid_.precondition(all(r_), all(z_), all(q_), threads);
  }
  return sum_rows(
      [&](const Row<D>& row) {
        const Real* const r = r_.data() + row.at;
        Real* const z = z_.data() + row.at;
        if (diagonal)
          for (int i = 0; i < row.length; ++i) z[i] = r[i] * inverse[row.at + i];
        return sum_over(row.length, [&]<int kLanes>(int i) {
          return Vector<double, kLanes * 8>(doubles<kLanes>(r + i) * doubles<kLanes>(z + i));
        });
      },
      threads);
}

// d = z + beta d and q = A d; returns d . q.
template <class Real, int D>
double PressureSolver<Real, D>::next_direction(Real beta, int threads) {
  const Real* const inverse = multigrid_.inverse_diagonal().data();
  for_planes_in_stages<2>(
      fluid(),
      [&](int stage, int plane) {
        double sum = 0;
        for_rows(fluid(), plane, [&](const Row<D>& row) {
          Real *const d = d_.data() + row.at, *const q = q_.data() + row.at;
          if (stage == 0) {
            const Real* const z = z_.data() + row.at;
            if (beta == 0) {  // d may be anything
              std::copy_n(z, row.length, d);
            } else {
              for (int i = 0; i < row.length; ++i) d[i] = z[i] + beta * d[i];
            }
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
  if (!bodies_) return sum_parts();
  const std::span<const Real> d(d_.data(), d_.size());
  return sum_parts() + bodies_->add_product(Real(1), d, std::span(q_.data(), q_.size()), threads);
}

// p += alpha d, r -= alpha q; returns |r|.
template <class Real, int D>
double PressureSolver<Real, D>::move(double alpha, std::span<double> p, int threads) {
  return std::sqrt(sum_rows(
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
      threads));
}

// Conjugate gradients from r on, until |r| <= goal, the iterations are used up, or they stall.
template <class Real, int D>
auto PressureSolver<Real, D>::iterate(std::span<double> p, double goal, int max_iterations,
                                      SolveReport& report, int threads) -> End {
  constexpr int kPatience = 20;  // iterations in which multigrid must have halved the residual
  const bool patient = report.preconditioner == Preconditioner::kDiagonal;
  double rz = 0, best = report.residual;
  for (int iteration = 0, since = 0; report.iterations < max_iterations; ++iteration) {
    poll_interrupt();
    // Rounding gives r a mean, and multigrid makes much of what is nearly constant.
    regions_.remove_means(std::span(r_.data(), r_.size()), threads);
    const double before = rz;
    rz = precondition(report.preconditioner, threads);
    // Bodies feel the mean of a pressure that they close in; it is 0 in all that is found.
    const bool felt = bodies_ && regions_.count() > 0;
    if (felt) regions_.remove_means(std::span(z_.data(), z_.size()), threads);
    if (!(rz > 0)) return End::kStalled;
    const double dq = next_direction(iteration == 0 ? 0 : static_cast<Real>(rz / before), threads);
    if (!(dq > 0) || !std::isfinite(rz / dq)) return End::kStalled;
    report.residual = move(rz / dq, p, threads);
    if (felt) {
      regions_.remove_means(std::span(r_.data(), r_.size()), threads);
      report.residual = norm_of_r(threads);
    }
    ++report.iterations;
    if (report.residual <= goal) return End::kGoal;
    if (!std::isfinite(report.residual)) return End::kStalled;
    if (report.residual < 0.5 * best) {
      best = report.residual, since = 0;
    } else if (++since >= kPatience && !patient) {
      return End::kStalled;
    }
  }
  return End::kUsedUp;
}

template <class Real, int D>
SolveReport PressureSolver<Real, D>::solve(std::span<const Real> b, std::span<double> p,
                                           double tolerance, int max_iterations, int threads,
                                           const Bodies<Real, D>* bodies) {
  bodies_ = bodies && bodies->any() ? bodies : nullptr;
  SolveReport report;
  report.closed_regions = regions_.count();
  double goal = 0, norm = 0;
  // r of p, which is forgotten where 0 is better.
  const auto begin = [&] {
    norm = set_right_side(b, report, threads);
    goal = tolerance * norm;
    clear(p, true, threads);
    if (bodies_) regions_.remove_means(p, threads);
    report.residual = subtract_product(p, threads);
    if (regions_.count() > 0) {  // what rounding left of the means
      regions_.remove_means(std::span(r_.data(), r_.size()), threads);
      report.residual = norm_of_r(threads);
    }
    if (report.residual <= norm) return;
    clear(p, false, threads);
    report.residual = set_right_side(b, report, threads);
  };
  begin();
  // What the iterations leave of r is compared with b - A p, and they begin anew where that is
  // more.
  while (report.residual > goal) {
    const double before = report.residual;
    const End end = iterate(p, goal, max_iterations, report, threads);
    begin();
    if (report.residual <= goal || end == End::kUsedUp) break;
    if (end == End::kGoal && report.residual < 0.5 * before) continue;
    if (report.preconditioner == Preconditioner::kDiagonal) break;
    report.preconditioner = Preconditioner::kDiagonal;
    for (const int n : layout_.cells) max_iterations += kDiagonalIterations * n;
  }
  report.converged = report.residual <= goal;
  if (norm > 0) report.residual /= norm;
  regions_.remove_means(p, threads);
  return report;
}

template class PressureSolver<float, 2>;
template class PressureSolver<float, 3>;
template class PressureSolver<double, 2>;
template class PressureSolver<double, 3>;

}  // namespace substep::gridfluid
