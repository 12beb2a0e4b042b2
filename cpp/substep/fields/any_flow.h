// A flow (flows.h) for those who choose it, its method and its precision when they run.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "substep/core/numbers.h"
#include "substep/fields/steps.h"

namespace substep::fields {

class AnyFlow {
 public:
  virtual ~AnyFlow() = default;
  // Of rows x, of either precision; results are of the same.
  virtual void velocity(double t, NumbersIn x, NumbersOut u, int threads) const = 0;
  virtual void advect(const std::string& method, NumbersIn x, NumbersOut x_new, const Steps& steps,
                      int threads) const = 0;
};

// InputError: there is no such flow, or it has not so many parameters.
std::unique_ptr<AnyFlow> make_flow(const std::string& kind, int dimension,
                                   std::span<const double> parameters);

// The tables of the methods, for callables of the user.
struct MethodTable {
  std::string name;
  std::vector<std::vector<double>> a;
  std::vector<double> b, c;
  double divisor;  // of b
};
std::vector<MethodTable> method_tables();

}  // namespace substep::fields
