// Steps of one length by a method of tableaux::FixedMethods:
//   k_i = f(t + c_i h, x + h sum_j a_ij k_j),  x(t + h) = x + h / D sum_i b_i k_i
// with whole b_i and their sum D (WholeWeights). The loops unroll and zeros vanish, so a stage
// costs what it needs.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "substep/core/errors.h"
#include "substep/core/tableau.h"

namespace substep::fields {

// Time after n steps, the same bits however the steps are grouped into calls.
struct Steps {
  double origin, h;    // [s]; h < 0 goes back in time
  std::int64_t first;  // number of the first step since `origin`
  std::int64_t count;
  double time(std::int64_t step) const { return origin + static_cast<double>(first + step) * h; }
};

// Calls action(table) for the method of that name.
template <class Action>
void with_method(std::string_view name, Action&& action) {
  bool found = false;
  tableaux::for_each_method<tableaux::FixedMethods>([&](const auto& table) {
    if (table.name == name) action(table), found = true;
  });
  if (!found) throw InputError("method: unknown name " + std::string(name));
}

}  // namespace substep::fields
