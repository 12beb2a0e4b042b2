#include "substep/ode/solve/methods.h"

#include "substep/core/tableau.h"
#include "substep/ode/explicit/rkc.h"
#include "substep/ode/explicit/runge_kutta.h"

namespace substep::ode {
namespace {

std::vector<Method> list() {
  std::vector<Method> all;
  const auto add = [&]<class T>(const T&, Family family) {
    constexpr bool doubling = T::estimate == Estimate::doubling;
    int error_order = T::order;
    if constexpr (!doubling) error_order = T::error_order;
    all.push_back({T::name, family, T::order, error_order, doubling});
  };
  std::apply([&](const auto&... t) { (add(t, Family::explicit_table), ...); }, Methods{});
  std::apply([&](const auto&... t) { (add(t, Family::implicit), ...); }, ImplicitMethods{});
  all.push_back({kRkc2, Family::stabilized, 2, 2, false});
  return all;
}

}  // namespace

const std::vector<Method>& methods() {
  static const std::vector<Method> all = list();
  return all;
}

}  // namespace substep::ode
