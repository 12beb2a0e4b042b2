// Systems whose size is known when they are compiled: f and the stages become one loop without
// calls, y in registers. Derive and give `void eval(double t, const double* y, double* dydt)
// const`, and for the implicit methods `void eval_jacobian(double t, const double* y, double* J)
// const`: df/dy column by column, J[j * N + i] = df_i/dy_j.
#pragma once

#include <string_view>

#include "substep/ode/explicit/runge_kutta.h"
#include "substep/ode/implicit/implicit.h"
#include "substep/ode/stepping/combine.h"
#include "substep/ode/stepping/system.h"

namespace substep::ode {

// The fixed steps of a tableau for N components, f(t, y, dydt) inlined where it can be.
template <class T, int N, class F>
void run_fixed(const FixedRun& run, F&& f) {
  double y[N], y_new[N], k[T::stages][N];
  for (int i = 0; i < N; ++i) y[i] = run.y[i];
  for (std::int64_t step = 0; step < run.steps; ++step) {
    const double t = run.t + static_cast<double>(run.first + step) * run.h;
    f(t, y, k[0]);
    unrolled_step<T>(t, run.h, y, k, y_new, f);
    for (int i = 0; i < N; ++i) y[i] = y_new[i];
  }
  for (int i = 0; i < N; ++i) run.y[i] = y[i];
}

// The same for the method that the run names; false if there is none of that name.
template <int N, class F>
bool run_fixed_by_name(const FixedRun& run, F&& f) {
  bool found = false;
  const auto match = [&]<class T>(const T&) {
    if (T::name == run.method) run_fixed<T, N>(run, f), found = true;
  };
  std::apply([&](const auto&... t) { (match(t), ...); }, Methods{});
  return found;
}

template <class Derived>
constexpr bool kHasJacobian =
    requires(const Derived& f, const double* y, double* J) { f.eval_jacobian(0.0, y, J); };

template <class Derived, int N>
class StaticSystem : public System {
 public:
  static constexpr int kSize = N;

  std::int64_t size() const final { return N; }
  void rhs(double t, const double* y, double* dydt) final;
  bool has_jacobian() const final { return kHasJacobian<Derived>; }
  void jacobian(double t, const double* y, double* values) final;
  bool fixed_steps(const FixedRun& run) override;
  std::unique_ptr<Stepper> make_stepper(std::string_view method,
                                        const StepOptions& options) override;

 private:
  Derived& derived() { return static_cast<Derived&>(*this); }
};

template <class Derived, int N>
void StaticSystem<Derived, N>::rhs(double t, const double* y, double* dydt) {
  derived().eval(t, y, dydt);
}

template <class Derived, int N>
void StaticSystem<Derived, N>::jacobian(double t, const double* y, double* values) {
  if constexpr (kHasJacobian<Derived>) {
    derived().eval_jacobian(t, y, values);
  } else {
    System::jacobian(t, y, values);
  }
}

template <class Derived, int N>
bool StaticSystem<Derived, N>::fixed_steps(const FixedRun& run) {
  const Derived& f = derived();
  return run_fixed_by_name<N>(
      run, [&f](double t, const double* y, double* dydt) { f.eval(t, y, dydt); });
}

template <class Derived, int N>
std::unique_ptr<Stepper> StaticSystem<Derived, N>::make_stepper(std::string_view method,
                                                                const StepOptions& options) {
  // The pairs are worth their code; the others are fused where they are used, at fixed steps.
  auto stepper = make_runge_kutta<Pairs>(method, derived(), options);
  if constexpr (kHasJacobian<Derived>) {
    if (!stepper) stepper = make_static_implicit(method, derived(), options);
  }
  return stepper ? std::move(stepper) : System::make_stepper(method, options);
}

}  // namespace substep::ode
