// CHOLMOD's workspace and the matrices that it borrows from us.
#pragma once

#include <cholmod.h>

#include <cstring>
#include <new>
#include <span>

#include "substep/core/usize.h"
#include "substep/linalg/sparse.h"

namespace substep {

// Silent: errors are read from `status`.
struct CholmodCommon : cholmod_common {
  CholmodCommon() {
    cholmod_start(this);
    print = 0;
    error_handler = nullptr;
    try_catch = 1;
  }
  ~CholmodCommon() { cholmod_finish(this); }
  CholmodCommon(const CholmodCommon&) = delete;
  CholmodCommon& operator=(const CholmodCommon&) = delete;

  void throw_if_out_of_memory() const {
    if (status == CHOLMOD_OUT_OF_MEMORY || status == CHOLMOD_TOO_LARGE) throw std::bad_alloc();
  }
};

// A view; CHOLMOD does not write to a matrix that it is given to read.
inline cholmod_sparse cholmod_lower(const SparsePattern& pattern, const double* values) {
  cholmod_sparse a{};
  a.nrow = usize(pattern.rows);
  a.ncol = usize(pattern.cols);
  a.nzmax = pattern.row.size();
  a.p = const_cast<std::int32_t*>(pattern.start.data());
  a.i = const_cast<std::int32_t*>(pattern.row.data());
  a.x = const_cast<double*>(values);
  a.stype = -1;
  a.itype = CHOLMOD_INT;
  a.xtype = values ? CHOLMOD_REAL : CHOLMOD_PATTERN;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = 1;
  a.packed = 1;
  return a;
}

}  // namespace substep
