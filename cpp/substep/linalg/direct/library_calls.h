// What every call of SuiteSparse stands under.
#pragma once

#include <string>

namespace substep {

// Holds while this thread is inside SuiteSparse. OpenMP regions, which libcholmod has, run on the
// calling thread alone: libgomp's threads do not survive fork(), and a child that opened a region
// would wait for them for ever. Where OpenBLAS keeps the work space of its products in a table
// without a lock (its serial build) and does not take ours (blas_buffers.cpp), one thread at a
// time.
class LibraryCalls {
 public:
  LibraryCalls();
  ~LibraryCalls();
  LibraryCalls(const LibraryCalls&) = delete;
  LibraryCalls& operator=(const LibraryCalls&) = delete;

 private:
  int levels_;
  bool locked_;
};

struct LibraryVersions {
  std::string suitesparse;
  std::string blas;        // name, version and kernels; "unknown" if it is not OpenBLAS
  bool blas_is_serial;     // OpenBLAS without threads of its own
  bool blas_is_reentrant;  // several threads may be inside it at once
  bool gpl;                // supernodal CHOLMOD and UMFPACK are in use
};
LibraryVersions library_versions();

}  // namespace substep
