// What LU asks of the library below it.
#pragma once

#include <memory>
#include <span>

#include "substep/linalg/direct/lu.h"

namespace substep {

template <class T>
class LULibrary {
 public:
  virtual ~LULibrary() = default;
  // Keeps what it can of the analysis. Returns the row at which A is singular, or -1; fills in
  // factor_entries and rcond. Throws std::bad_alloc.
  virtual std::int32_t factor(std::span<const T> values, LUReport& report) = 0;
  // One right-hand side; b and x are different arrays.
  virtual void solve(const T* b, T* x, bool transpose) = 0;
};

// They keep a reference to the pattern. Throw std::bad_alloc.
template <class T>
std::unique_ptr<LULibrary<T>> make_klu(const SparsePattern& pattern);
#if SUBSTEP_GPL
template <class T>
std::unique_ptr<LULibrary<T>> make_umfpack(const SparsePattern& pattern);
#endif

}  // namespace substep
