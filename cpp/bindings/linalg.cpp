#include "bindings.h"
#include "substep/linalg/library_calls.h"

void bind_linalg(py::module_& m) {
  m.def("library_versions", [] {
    const substep::LibraryVersions versions = substep::library_versions();
    py::dict entries;
    entries["suitesparse"] = versions.suitesparse;
    entries["blas"] = versions.blas;
    entries["blas_is_serial"] = versions.blas_is_serial;
    entries["blas_is_reentrant"] = versions.blas_is_reentrant;
    entries["gpl"] = versions.gpl;
    return entries;
  });
}
