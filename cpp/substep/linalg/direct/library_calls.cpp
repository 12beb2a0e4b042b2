#include "substep/linalg/direct/library_calls.h"

#include <SuiteSparse_config.h>
#include <dlfcn.h>
#include <omp.h>

#include <mutex>

#include "substep/linalg/direct/blas_buffers.h"

namespace substep {
namespace {

template <class Function>
Function* symbol(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_DEFAULT, name));
}

std::mutex one_at_a_time;

}  // namespace

LibraryCalls::LibraryCalls() : levels_(omp_get_max_active_levels()), locked_(!blas_is_reentrant()) {
  reserve_blas_buffer();
  if (locked_) one_at_a_time.lock();
  omp_set_max_active_levels(0);
}

LibraryCalls::~LibraryCalls() {
  omp_set_max_active_levels(levels_);
  if (locked_) one_at_a_time.unlock();
}

LibraryVersions library_versions() {
  LibraryVersions versions;
  int number[3];
  SuiteSparse_version(number);
  versions.suitesparse =
      std::to_string(number[0]) + "." + std::to_string(number[1]) + "." + std::to_string(number[2]);
  const auto config = symbol<char*()>("openblas_get_config");
  const auto core = symbol<char*()>("openblas_get_corename");
  const auto parallel = symbol<int()>("openblas_get_parallel");
  versions.blas = config ? config() : "unknown";
  if (core) versions.blas += std::string(", kernels for ") + core();
  versions.blas_is_serial = parallel && parallel() == 0;
  versions.blas_is_reentrant = blas_is_reentrant();
  versions.gpl = SUBSTEP_GPL;
  return versions;
}

}  // namespace substep
