#pragma once

#include <cstdint>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

// A compiled function of the user's: void(double t, double* y, double* dydt, double* p), as
// numbalsoda calls it. It must leave y alone.
class PointerSystem final : public System {
 public:
  using Function = void (*)(double t, double* y, double* dydt, double* p);

  PointerSystem(Function function, std::int64_t size, double* parameters)
      : function_(function), size_(size), parameters_(parameters) {}

  std::int64_t size() const override { return size_; }
  void rhs(double t, const double* y, double* dydt) override {
    function_(t, const_cast<double*>(y), dydt, parameters_);
  }
  bool fixed_steps(const FixedRun& run) override;

 private:
  Function function_;
  std::int64_t size_;
  double* parameters_;
};

}  // namespace substep::ode
