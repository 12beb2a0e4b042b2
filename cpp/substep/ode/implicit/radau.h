// Radau IIA of order 5 with Hairer's step control.
// [HW] Hairer, Wanner, "Solving Ordinary Differential Equations II", 2nd ed., IV.5 and IV.8.
//
// Stages Y_i = y + Z_i,  M Z_i = h sum_j a_ij f(t + c_j h, Y_j),  y_new = Y_3.         [HW] (8.2)
// A^-1 = T diag(gamma, [[alpha, -beta], [beta, alpha]]) T^-1 uncouples Newton's equations for
// W = T^-1 Z into one real and one complex system:                                  [HW] (8.13)
//   (gamma/h M - J) dW_1 = (T^-1 F)_1 - gamma/h M W_1
//   ((alpha + i beta)/h M - J)(dW_2 + i dW_3) = (T^-1 F)_{2 + i 3} - (alpha + i beta)/h M (W_2 + i
//   W_3)
#pragma once

#include "substep/core/tableau.h"
#include "substep/core/usize.h"
#include "substep/ode/implicit/implicit_step.h"

namespace substep::ode {

// T, T^-1 and the eigenvalues for the tableau RadauIIA5, as in Hairer's RADAU5; beta carries the
// sign that belongs to this T.
struct RadauTransform {
  static constexpr double T[3][3] = {
      {0.09443876248897524, -0.14125529502095421, 0.03002919410514742},
      {0.25021312296533332, 0.20412935229379994, -0.38294211275726192},
      {1.0, 1.0, 0.0}};
  static constexpr double inverse[3][3] = {
      {4.17871859155190428, 0.32768282076106237, 0.52337644549944951},
      {-4.17871859155190428, -0.32768282076106237, 0.47662355450055044},
      {0.50287263494578682, -2.57192694985560522, 0.59603920482822492}};
  static constexpr double gamma = 3.637834252744496, alpha = 2.6810828736277521,
                          beta = -3.0504301992474105;
  // Weights of the estimate, gamma_0 (b^ - b) A^-1 up to the factor gamma:      [HW] (8.19)
  static constexpr double e[3] = {-10.048809399827416, 1.3821427331607489, -1.0 / 3.0};
  // y_old + sum_k Q_k theta^k with Q = P^T Z is the collocation polynomial.
  static constexpr double P[3][3] = {{10.048809399827416, -25.629591447076636, 15.580782047249224},
                                     {-1.3821427331607489, 10.296258113743303, -8.914115380582557},
                                     {1.0 / 3.0, -8.0 / 3.0, 10.0 / 3.0}};
};

template <class Sys, class Matrices>
class Radau final : public ImplicitStep<Sys, Matrices> {
  using Base = ImplicitStep<Sys, Matrices>;
  using Transform = RadauTransform;
  using Table = RadauIIA5;

 public:
  Radau(Sys& system, const StepOptions& options, std::unique_ptr<Matrices> matrices)
      : Base(system, options, std::move(matrices), Table::name, Table::error_order) {
    const std::size_t size = y_.size();
    for (int r = 0; r < 3; ++r) {
      Z_[r].resize(size), Z_old_[r].resize(size), W_[r].resize(size), F_[r].resize(size);
    }
    if (has_mass_) MW_.resize(3 * size);
    error_.resize(size);
  }

  int dense_rows() const override { return 3; }

  // The collocation polynomial in the nested form of interpolate():
  // F_1 = Q_1 + Q_2 + Q_3, F_2 = -Q_2 - Q_3, F_3 = -Q_3.
  void dense(double* F) override {
    const std::int64_t n = Base::n();
    const double *Z0 = Z_old_[0].data(), *Z1 = Z_old_[1].data(), *Z2 = Z_old_[2].data();
    constexpr auto& P = Transform::P;
    for (std::int64_t i = 0; i < n; ++i) {
      F[i] = y_[usize(i)] - y_old_[usize(i)];
      if (this->step_was_split()) {
        F[n + i] = F[2 * n + i] = 0.0;
        continue;
      }
      const double Q2 = P[0][1] * Z0[i] + P[1][1] * Z1[i] + P[2][1] * Z2[i];
      const double Q3 = P[0][2] * Z0[i] + P[1][2] * Z1[i] + P[2][2] * Z2[i];
      F[n + i] = -Q2 - Q3;
      F[2 * n + i] = -Q3;
    }
  }

 private:
  using Base::direction_;
  using Base::f_;
  using Base::h_abs_;
  using Base::has_mass_;
  using Base::matrices_;
  using Base::max_step_;
  using Base::progress_;
  using Base::t_;
  using Base::y_;
  using Base::y_new_;
  using Base::y_old_;

  bool f_is_current() const override { return f_current_; }

  void factor(int, double h) override {
    matrices_->factor(0, Transform::gamma / h);
    matrices_->factor(Complex{Transform::alpha / h, Transform::beta / h});
    if (matrices_->factorizes()) this->factorizations_ += 2;
  }

  bool iterate(int, double t, double h, const double* y, double* y_new) override {
    predict(h);
    const std::int64_t n = Base::n();
    progress_.start();
    for (;;) {
      for (int r = 0; r < 3; ++r) {
        const double* Z = Z_[r].data();
        for (std::int64_t i = 0; i < n; ++i) y_new[i] = y[i] + Z[i];
        const double at = t + Table::c[r] * h;
        this->rhs(at, y_new, F_[r].data());
        if (!all_finite(F_[r].data(), n)) return this->note_not_finite(at, F_[r].data(), r + 1);
      }
      residual(h);
      matrices_->solve(0, F_[0].data());
      matrices_->solve(F_[1].data(), F_[2].data());
      const double norm = this->increment_norm(3, [&](int r) { return F_[r].data(); });
      update();
      for (std::int64_t i = 0; i < n; ++i) y_new[i] = y[i] + Z_[2][usize(i)];
      if (progress_.count() == 0) this->widen_scale(y_new);
      const auto verdict = progress_.next(norm);
      if (verdict == NewtonProgress::Verdict::converged) return all_finite(y_new, n);
      if (verdict == NewtonProgress::Verdict::diverged) return false;
    }
  }

  // Z and W from the last step's polynomial, continued ([HW] (8.5)); 0 at the start.
  void predict(double h) {
    const std::int64_t n = Base::n();
    constexpr auto& S = Transform::inverse;
    double K[3][3] = {};  // Z_i = sum_j K_ij Z_old_j
    if (h_last_ != 0.0) {
      for (int i = 0; i < 3; ++i) {
        const double theta = 1.0 + Table::c[i] * (h / h_last_), theta2 = theta * theta;
        const double powers[3] = {theta - 1.0, theta2 - 1.0, theta2 * theta - 1.0};
        for (int j = 0; j < 3; ++j) {
          for (int k = 0; k < 3; ++k) K[i][j] += powers[k] * Transform::P[j][k];
        }
      }
    }
    const double *a = Z_old_[0].data(), *b = Z_old_[1].data(), *c = Z_old_[2].data();
    double *Z0 = Z_[0].data(), *Z1 = Z_[1].data(), *Z2 = Z_[2].data();
    double *W0 = W_[0].data(), *W1 = W_[1].data(), *W2 = W_[2].data();
#pragma GCC ivdep
    for (std::int64_t i = 0; i < n; ++i) {
      const double z0 = K[0][0] * a[i] + K[0][1] * b[i] + K[0][2] * c[i];
      const double z1 = K[1][0] * a[i] + K[1][1] * b[i] + K[1][2] * c[i];
      const double z2 = K[2][0] * a[i] + K[2][1] * b[i] + K[2][2] * c[i];
      Z0[i] = z0, Z1[i] = z1, Z2[i] = z2;
      W0[i] = S[0][0] * z0 + S[0][1] * z1 + S[0][2] * z2;
      W1[i] = S[1][0] * z0 + S[1][1] * z1 + S[1][2] * z2;
      W2[i] = S[2][0] * z0 + S[2][1] * z1 + S[2][2] * z2;
    }
  }

  // The right-hand sides of (8.13) in place of F.
  void residual(double h) {
    const std::int64_t n = Base::n();
    constexpr auto& S = Transform::inverse;
    const double gamma = Transform::gamma / h, alpha = Transform::alpha / h,
                 beta = Transform::beta / h;
    const double *W0 = W_[0].data(), *W1 = W_[1].data(), *W2 = W_[2].data();
    if (has_mass_) {
      double* MW = MW_.data();
      matrices_->multiply_mass(W0, MW);
      matrices_->multiply_mass(W1, MW + n);
      matrices_->multiply_mass(W2, MW + 2 * n);
      W0 = MW, W1 = MW + n, W2 = MW + 2 * n;
    }
    double *F0 = F_[0].data(), *F1 = F_[1].data(), *F2 = F_[2].data();
#pragma GCC ivdep
    for (std::int64_t i = 0; i < n; ++i) {
      const double f0 = F0[i], f1 = F1[i], f2 = F2[i];
      F0[i] = S[0][0] * f0 + S[0][1] * f1 + S[0][2] * f2 - gamma * W0[i];
      F1[i] = S[1][0] * f0 + S[1][1] * f1 + S[1][2] * f2 - (alpha * W1[i] - beta * W2[i]);
      F2[i] = S[2][0] * f0 + S[2][1] * f1 + S[2][2] * f2 - (alpha * W2[i] + beta * W1[i]);
    }
  }

  // W += dW, Z = T W.
  void update() {
    const std::int64_t n = Base::n();
    constexpr auto& T = Transform::T;
    const double *d0 = F_[0].data(), *d1 = F_[1].data(), *d2 = F_[2].data();
    double *Z0 = Z_[0].data(), *Z1 = Z_[1].data(), *Z2 = Z_[2].data();
    double *W0 = W_[0].data(), *W1 = W_[1].data(), *W2 = W_[2].data();
#pragma GCC ivdep
    for (std::int64_t i = 0; i < n; ++i) {
      const double w0 = W0[i] += d0[i], w1 = W1[i] += d1[i], w2 = W2[i] += d2[i];
      Z0[i] = T[0][0] * w0 + T[0][1] * w1 + T[0][2] * w2;
      Z1[i] = T[1][0] * w0 + T[1][1] * w1 + T[1][2] * w2;
      Z2[i] = w0 + w1;
    }
  }

  void fixed_step(double h) override {
    f_current_ = false;
    Base::fixed_step(h);
    keep(this->step_was_split() ? 0.0 : h);
  }

  // Z becomes that of the last step.
  void keep(double h) {
    for (int r = 0; r < 3; ++r) Z_[r].swap(Z_old_[r]);
    h_last_ = h;
  }

  void adaptive_step() override {
    const double smallest = smallest_step(t_, direction_);
    double h_abs = h_abs_ > max_step_ ? max_step_ : std::max(h_abs_, smallest);
    bool rejected = false;
    if (h_abs != h_abs_) error_last_ = 0.0;
    for (;;) {
      if (h_abs < smallest) this->fail(t_);
      const double t_new = this->end_of_step(h_abs), h = t_new - t_;
      if (!this->solve(0, t_, h, y_.data(), y_new_.data())) {
        h_abs *= 0.5;
        rejected = true;
        continue;
      }
      // [HW] after (8.21): cautious where many iterations were needed.
      const double most = 2.0 * progress_.most() - 2.0;
      const double safety = kSafety * (most + 1.0) / (most + progress_.count());
      const double error = estimate(h, rejected || this->steps_ == 0);
      const double factor = safety * predicted_factor(h_abs, error);
      if (!(error < 1.0)) {
        this->note_error_too_large();
        h_abs *= std::max(kMinFactor, factor);
        rejected = true;
        continue;
      }
      accept_step(t_new, h_abs, error, rejected ? std::min(1.0, factor) : factor);
      return;
    }
  }

  void accept_step(double t_new, double h_abs, double error, double factor) {
    const double h = t_new - t_;
    // The factors are kept where the step would hardly grow ([HW] after (8.22), SciPy's bound).
    const bool same = factor < 1.2 && !this->jacobian_is_old();
    h_last_abs_ = h_abs;
    error_last_ = std::max(1e-2, error);
    h_abs_ = same ? h_abs : h_abs * std::min(kMaxFactor, factor);
    keep(h);
    this->accept(t_new);
    this->rhs(t_, y_.data(), f_.data());
    f_current_ = true;
  }

  // [HW] (8.19), (8.20): (gamma/h M - J)^-1 (f(t, y) + M (e_1 Z_1 + e_2 Z_2 + e_3 Z_3)/h), once
  // more through f where the step is the first or follows a rejection.
  double estimate(double h, bool again) {
    const std::int64_t n = Base::n();
    const double *Z0 = Z_[0].data(), *Z1 = Z_[1].data(), *Z2 = Z_[2].data();
    double *ZE = F_[0].data(), *error = error_.data();
    const double e0 = Transform::e[0] / h, e1 = Transform::e[1] / h, e2 = Transform::e[2] / h;
    for (std::int64_t i = 0; i < n; ++i) error[i] = e0 * Z0[i] + e1 * Z1[i] + e2 * Z2[i];
    if (has_mass_) {
      matrices_->multiply_mass(error, ZE);
    } else {
      std::copy_n(error, n, ZE);
    }
    for (std::int64_t i = 0; i < n; ++i) error[i] = f_[usize(i)] + ZE[i];
    this->set_estimate_accuracy();
    matrices_->solve(0, error);
    const double norm = this->error_norm(error);
    if (norm < 1.0 || !again) return norm;
    double *y = F_[1].data(), *f = F_[2].data();
    for (std::int64_t i = 0; i < n; ++i) y[i] = y_[usize(i)] + error[i];
    this->rhs(t_, y, f);
    for (std::int64_t i = 0; i < n; ++i) error[i] = f[i] + ZE[i];
    matrices_->solve(0, error);
    return this->error_norm(error);
  }

  // The lesser of the elementary and Gustafsson's predictive controller, [HW] (8.21), (8.22).
  double predicted_factor(double h_abs, double error) const {
    if (error == 0.0) return kMaxFactor;
    const double plain = 1.0 / std::sqrt(std::sqrt(error));
    if (error_last_ == 0.0) return plain;
    const double trend = h_abs / h_last_abs_ * std::sqrt(std::sqrt(error_last_ / error));
    return plain * std::min(1.0, trend);
  }

  std::vector<double> Z_[3], Z_old_[3], W_[3], F_[3], MW_, error_;
  double h_last_ = 0.0;  // of the step that Z_old_ belongs to; 0: no prediction
  double h_last_abs_ = 0.0, error_last_ = 0.0;
  bool f_current_ = true;
};

}  // namespace substep::ode
