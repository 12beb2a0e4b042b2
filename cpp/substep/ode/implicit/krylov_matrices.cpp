// (s M - J) x = b by BiCGSTAB, J and M known by their products: van der Vorst, SIAM J. Sci. Stat.
// Comput. 13 (1992) 631, preconditioned from the right, in the inner product that is weighted as
// the error norm of the step. Complex vectors lie in two planes, since J and M are real. The
// preconditioner is the inverse of the diagonal blocks.
#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/ode/implicit/matrix_kinds.h"

namespace substep::ode {
namespace {

// A vector of n numbers, complex ones in two planes.
template <class T>
constexpr std::size_t kPlanes = std::is_same_v<T, Complex> ? 2 : 1;

template <class T>
struct Vector {
  std::array<std::vector<double>, kPlanes<T>> plane;
  void resize(std::size_t n) {
    for (auto& values : plane) values.resize(n);
  }
  [[gnu::always_inline]] T at(std::size_t i) const {
    if constexpr (kPlanes<T> == 1) {
      return plane[0][i];
    } else {
      return {plane[0][i], plane[1][i]};
    }
  }
  [[gnu::always_inline]] void set(std::size_t i, T value) {
    if constexpr (kPlanes<T> == 1) {
      plane[0][i] = value;
    } else {
      plane[0][i] = value.re, plane[1][i] = value.im;
    }
  }
};

Complex operator+(Complex a, Complex b) { return {a.re + b.re, a.im + b.im}; }
Complex operator-(Complex a, Complex b) { return {a.re - b.re, a.im - b.im}; }
double real(double a) { return a; }
double real(Complex a) { return a.re; }
double imaginary(double) { return 0.0; }
double imaginary(Complex a) { return a.im; }
double square(double a) { return a * a; }
double square(Complex a) { return a.re * a.re + a.im * a.im; }
// conj(a) b
double inner(double a, double b) { return a * b; }
Complex inner(Complex a, Complex b) {
  return {a.re * b.re + a.im * b.im, a.re * b.im - a.im * b.re};
}
template <class T>
T number(double re, double im) {
  if constexpr (kPlanes<T> == 1) {
    return re;
  } else {
    return {re, im};
  }
}

constexpr std::int64_t kKrylovChunk = 4096;

// Calls body(i, sums) for each i; the sums of the chunks are added in order.
template <std::size_t M, class Body>
std::array<double, M> for_sums(std::size_t n, int threads, Body&& body) {
  const auto size = static_cast<std::int64_t>(n);
  std::vector<std::array<double, M>> parts(n / kKrylovChunk + 1);
  parallel_for(
      size, kKrylovChunk,
      [&](std::int64_t begin, std::int64_t end) {
        std::array<double, M> sum{};
        for (std::int64_t i = begin; i < end; ++i) body(usize(i), sum);
        parts[usize(begin / kKrylovChunk)] = sum;
      },
      threads);
  std::array<double, M> total{};
  for (const auto& part : parts) {
    for (std::size_t m = 0; m < M; ++m) total[m] += part[m];
  }
  return total;
}

class KrylovNewtonMatrices final : public NewtonMatrices {
 public:
  KrylovNewtonMatrices(System& system, std::shared_ptr<Jacobian> jacobian,
                       const StepOptions& options)
      : system_(system),
        n_(usize(system.size())),
        threads_(options.threads),
        jacobian_(std::move(jacobian)),
        mass_(options.mass),
        by_product_(!options.jacobian && system.has_jacobian_product()) {
    weight_.assign(n_, 1.0);
  }

  bool constant() const override { return jacobian_->constant(); }
  bool has_mass() const override { return mass_ != nullptr; }

  std::int64_t evaluate(const JacobianPoint& at) override {
    const std::int64_t evaluations = jacobian_->evaluate(at, values_);
    const SparsePattern* pattern = jacobian_->pattern();
    check_jacobian(at.t, static_cast<std::int64_t>(n_), pattern, values_);
    if (!pattern && full_.rows == 0) full_ = full_pattern(static_cast<std::int64_t>(n_));
    set_rows(pattern ? *pattern : full_);
    t_ = at.t;
    y_.assign(at.y, at.y + n_);
    return evaluations;
  }

  bool factorizes() const override { return false; }

  // No factors: the shift, and the inverse of the diagonal blocks.
  void factor(int slot, double s) override {
    set_shift(real_[slot], {s, 0.0});
    operations_ = 0;
  }
  void factor(Complex s) override {
    set_shift(complex_, s);
    operations_ = 0;
  }
  bool reached() const override { return reached_; }
  double operations() const override { return operations_; }

  void set_accuracy(const double* scale, double tolerance) override {
    for (std::size_t i = 0; i < n_; ++i) weight_[i] = 1.0 / (scale[i] * scale[i]);
    tolerance_ = tolerance;
  }

  void solve(int slot, double* b) override { bicgstab<double>(real_work_, real_[slot], {b}); }
  void solve(double* re, double* im) override {
    bicgstab<Complex>(complex_work_, complex_, {re, im});
  }

  void multiply_mass(const double* x, double* out) const override {
    mass_->multiply(static_cast<std::int64_t>(n_), x, out);
  }

 private:
  // A solve ends where the residual is this fraction of the right-hand side, or leaves an error of
  // this fraction of what Newton's iteration may leave.
  static constexpr double kRelative = 0.01, kOfTolerance = 0.03;
  static constexpr int kMostIterations = 300;

  struct Shift {
    Complex s;
    std::vector<Complex> inverse;  // of the diagonal blocks, row by row
  };

  template <class T>
  struct Work {
    Vector<T> x, r, start, p, v, t, preconditioned, Mx;
  };

  // J by rows, and how far the blocks round the diagonal are full.
  void set_rows(const SparsePattern& pattern) {
    if (!(pattern == columns_)) {
      columns_ = pattern;
      rows_ = transposed(pattern, &entry_);
      block_ = 1;
      for (const std::size_t b : {4, 3, 2}) {
        if (n_ % b == 0 && block_ == 1 && blocks_are_full(b)) block_ = b;
      }
    }
    J_.resize(entry_.size());
    for (std::size_t k = 0; k < entry_.size(); ++k) {
      J_[k] = values_[usize(entry_[k])];
    }
  }

  bool blocks_are_full(std::size_t b) const {
    for (std::size_t i = 0; i < n_; ++i) {
      std::size_t found = 0;
      each_in_row(i, [&](std::size_t j, double) { found += j / b == i / b; });
      if (found < b) return false;
    }
    return true;
  }

  template <class Use>
  [[gnu::always_inline]] void each_in_row(std::size_t i, Use&& use) const {
    for (std::int32_t k = rows_.start[i]; k < rows_.start[i + 1]; ++k) {
      const auto entry = usize(k);
      use(usize(rows_.row[entry]), entry < J_.size() ? J_[entry] : 0.0);
    }
  }

  void set_shift(Shift& shift, Complex s) {
    const std::size_t b = block_;
    shift.s = s;
    shift.inverse.assign(n_ * b, {});
    Complex a[16], x[4];
    std::int32_t pivot[4];
    for (std::size_t first = 0; first < n_; first += b) {
      std::fill_n(a, b * b, Complex{});
      for (std::size_t i = first; i < first + b; ++i) {
        each_in_row(i, [&](std::size_t j, double value) {
          if (j / b == i / b) a[(j - first) * b + i - first] -= {value, 0.0};
        });
      }
      each_mass(first, b, [&](std::size_t i, std::size_t j, double m) {
        a[j * b + i] -= {-s.re * m, -s.im * m};
      });
      const auto rows = static_cast<std::int64_t>(b);
      const bool regular = lu_factor(rows, a, pivot) < 0;
      for (std::size_t j = 0; j < b; ++j) {
        std::fill_n(x, b, Complex{});
        x[j] = {1.0, 0.0};
        if (regular) lu_solve(rows, a, pivot, x);  // else the identity: it only speeds things up
        for (std::size_t i = 0; i < b; ++i) shift.inverse[(first + i) * b + j] = x[i];
      }
    }
  }

  // Entries of M in the diagonal block of b rows from `first`.
  template <class Use>
  void each_mass(std::size_t first, std::size_t b, Use&& use) const {
    for (std::size_t j = 0; j < b; ++j) {
      if (!mass_) {
        use(j, j, 1.0);
      } else if (!mass_->pattern) {
        for (std::size_t i = 0; i < b; ++i) {
          use(i, j, mass_->values[(first + j) * n_ + first + i]);
        }
      } else {
        const auto& start = mass_->pattern->start;
        for (std::int32_t k = start[first + j]; k < start[first + j + 1]; ++k) {
          const auto i = usize(mass_->pattern->row[usize(k)]);
          if (i / b == first / b) use(i - first, j, mass_->values[usize(k)]);
        }
      }
    }
  }

  template <class T>
  void precondition(const Shift& shift, const Vector<T>& x, Vector<T>& out) const {
    const std::size_t b = block_;
    const Complex* inverse = shift.inverse.data();
    parallel_for(
        static_cast<std::int64_t>(n_ / b), kKrylovChunk,
        [&](std::int64_t begin, std::int64_t end) {
          for (auto i = usize(begin) * b; i < usize(end) * b; ++i) {
            const std::size_t first = i / b * b;
            T sum{};
            for (std::size_t j = 0; j < b; ++j) {
              const Complex a = inverse[i * b + j];
              sum = sum + number<T>(a.re, a.im) * x.at(first + j);
            }
            out.set(i, sum);
          }
        },
        threads_);
  }

  // out = (s M - J) x
  template <class T>
  void multiply(Work<T>& work, const Shift& shift, const Vector<T>& x, Vector<T>& out) {
    const T s = number<T>(shift.s.re, shift.s.im);
    const Vector<T>* Mx = &x;
    if (mass_) {
      work.Mx.resize(n_);
      for (std::size_t p = 0; p < kPlanes<T>; ++p) {
        multiply_mass(x.plane[p].data(), work.Mx.plane[p].data());
      }
      Mx = &work.Mx;
    }
    if (by_product_) {
      for (std::size_t p = 0; p < kPlanes<T>; ++p) {
        system_.jacobian_product(t_, y_.data(), x.plane[p].data(), out.plane[p].data());
      }
    }
    parallel_for(
        static_cast<std::int64_t>(n_), kKrylovChunk,
        [&](std::int64_t begin, std::int64_t end) {
          for (auto i = usize(begin); i < usize(end); ++i) {
            T Jx{};
            if (by_product_) {
              Jx = out.at(i);
            } else {
              each_in_row(i, [&](std::size_t j, double value) {
                const T xj = x.at(j);
                Jx = Jx + number<T>(value * real(xj), value * imaginary(xj));
              });
            }
            out.set(i, s * Mx->at(i) - Jx);
          }
        },
        threads_);
  }

  template <class T>
  void bicgstab(Work<T>& work, const Shift& shift, const std::array<double*, kPlanes<T>>& b) {
    auto& [x, r, start, p, v, t, z, Mx] = work;
    for (Vector<T>* vector : {&x, &r, &start, &p, &v, &t, &z}) vector->resize(n_);
    const double* w = weight_.data();
    const double b2 = for_sums<1>(n_, threads_, [&](std::size_t i, auto& sum) {
      const T value = number<T>(b[0][i], b.back()[i]);
      r.set(i, value), start.set(i, value), p.set(i, value), x.set(i, T{});
      sum[0] += w[i] * square(value);
    })[0];
    // |x| is about |r| / |s| where J only damps: what Newton's iteration may leave is an RMS.
    const double allowed = kOfTolerance * tolerance_ * std::sqrt(square(shift.s));
    const double enough =
        std::max(kRelative * kRelative * b2, allowed * allowed * static_cast<double>(n_));
    double r2 = b2;
    T rho = number<T>(b2, 0.0);
    // Two products, two times the preconditioner, and the vectors.
    const double products = static_cast<double>(4 * rows_.row.size() + 4 * n_ * block_);
    const double of_iteration = kPlanes<T> * (products + 28.0 * static_cast<double>(n_));
    for (int k = 0; k < kMostIterations && r2 > enough; ++k) {
      operations_ += of_iteration;
      precondition(shift, p, z);
      multiply(work, shift, z, v);
      const auto sigma = for_sums<2>(n_, threads_, [&](std::size_t i, auto& sum) {
        const T term = inner(start.at(i), v.at(i));
        sum[0] += w[i] * real(term), sum[1] += w[i] * imaginary(term);
      });
      const T alpha = rho * reciprocal(number<T>(sigma[0], sigma[1]));
      if (!std::isfinite(real(alpha) + imaginary(alpha))) break;
      r2 = for_sums<1>(n_, threads_, [&](std::size_t i, auto& sum) {
        const T s = r.at(i) - alpha * v.at(i);
        r.set(i, s);
        x.set(i, x.at(i) + alpha * z.at(i));
        sum[0] += w[i] * square(s);
      })[0];
      if (r2 <= enough) break;
      precondition(shift, r, z);
      multiply(work, shift, z, t);
      const auto both = for_sums<3>(n_, threads_, [&](std::size_t i, auto& sum) {
        const T ti = t.at(i), term = inner(ti, r.at(i));
        sum[0] += w[i] * real(term), sum[1] += w[i] * imaginary(term), sum[2] += w[i] * square(ti);
      });
      const T omega = number<T>(both[0] / both[2], both[1] / both[2]);
      if (!std::isfinite(real(omega) + imaginary(omega))) break;
      const auto next = for_sums<3>(n_, threads_, [&](std::size_t i, auto& sum) {
        const T ri = r.at(i) - omega * t.at(i), term = inner(start.at(i), ri);
        r.set(i, ri);
        x.set(i, x.at(i) + omega * z.at(i));
        sum[0] += w[i] * real(term), sum[1] += w[i] * imaginary(term), sum[2] += w[i] * square(ri);
      });
      r2 = next[2];
      const T rho_next = number<T>(next[0], next[1]);
      const T beta = rho_next * reciprocal(rho) * (alpha * reciprocal(omega));
      if (!std::isfinite(real(beta) + imaginary(beta))) break;
      rho = rho_next;
      for_sums<0>(n_, threads_, [&](std::size_t i, auto&) {
        p.set(i, r.at(i) + beta * (p.at(i) - omega * v.at(i)));
      });
    }
    reached_ = r2 <= enough;
    for (std::size_t plane = 0; plane < kPlanes<T>; ++plane) {
      std::copy(x.plane[plane].begin(), x.plane[plane].end(), b[plane]);
    }
  }

  System& system_;
  std::size_t n_;
  int threads_;
  std::shared_ptr<Jacobian> jacobian_;
  std::shared_ptr<const MassMatrix> mass_;
  bool by_product_;
  double t_ = 0.0, tolerance_ = 0.0, operations_ = 0.0;
  bool reached_ = true;
  std::vector<double> y_, weight_, values_, J_;
  SparsePattern full_, columns_, rows_;
  std::vector<std::int32_t> entry_;
  std::size_t block_ = 1;
  Shift real_[kSlots], complex_;
  Work<double> real_work_;
  Work<Complex> complex_work_;
};

}  // namespace

std::unique_ptr<NewtonMatrices> make_krylov_matrices(System& system,
                                                     std::shared_ptr<Jacobian> jacobian,
                                                     const StepOptions& options) {
  return std::make_unique<KrylovNewtonMatrices>(system, std::move(jacobian), options);
}

}  // namespace substep::ode
