// One bind_* function per method folder; module.cpp calls them all. Names, shapes and casts only.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <unistd.h>

namespace py = pybind11;

// Gives the GIL back for a native loop, as py::gil_scoped_release does (also as a call_guard). The
// difference: where the interpreter ends meanwhile, CPython below 3.14 unwinds a daemon thread that
// wants the GIL again, and unwinding out of a destructor aborts the process. Here the thread is
// parked until the process ends, as CPython 3.14 does.
class ReleaseGil {
 public:
  ReleaseGil() : state_(PyEval_SaveThread()) {}
  ReleaseGil(const ReleaseGil&) = delete;
  ReleaseGil& operator=(const ReleaseGil&) = delete;
  ~ReleaseGil() {
    try {
      PyEval_RestoreThread(state_);
    } catch (...) {  // the unwinding of pthread_exit, nothing else
      for (;;) pause();
    }
  }

 private:
  PyThreadState* state_;
};

void bind_core(py::module_& m);
void bind_fields(py::module_& m);
void bind_geometry(py::module_& m);
void bind_linalg(py::module_& m);
void bind_mpm(py::module_& m);
void bind_neighbours(py::module_& m);
void bind_ode(py::module_& m);
void bind_pbf(py::module_& m);
void bind_pbd(py::module_& m);
void bind_pbd_collision(py::module_& m);
void bind_pbd_constraints(py::module_& m);
void bind_rigid(py::module_& m);
void bind_rigid_world(py::module_& m);
void bind_second_order(py::module_& m);
void bind_soft_body(py::module_& m);
void bind_springs(py::module_& m);
