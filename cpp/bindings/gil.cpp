// The end of the interpreter under threads that it does not wait for.
//
// A daemon thread that wants the GIL when the interpreter ends is unwound by CPython below 3.14
// (pthread_exit). That aborts the process in destructors that take the GIL, as those of pybind11's
// gil_scoped_release (one is within the first use of NumPy), and elsewhere drops references without
// the GIL. The linker puts these functions in the place of CPython's (--wrap), here and in
// pybind11: the thread is parked where it is until the process ends, as CPython 3.14 does.
#include <Python.h>
#include <unistd.h>

namespace {

template <class Call>
auto parked_if_unwound(const Call& call) {
  try {
    return call();
  } catch (...) {  // the unwinding of pthread_exit, nothing else
    for (;;) pause();
  }
}

}  // namespace

extern "C" {

PyGILState_STATE __real_PyGILState_Ensure();
void __real_PyEval_AcquireThread(PyThreadState*);
void __real_PyEval_RestoreThread(PyThreadState*);
PyObject* __real_PyImport_ImportModule(const char*);
PyObject* __real_PyObject_Vectorcall(PyObject*, PyObject* const*, size_t, PyObject*);

PyGILState_STATE __wrap_PyGILState_Ensure() { return parked_if_unwound(__real_PyGILState_Ensure); }
void __wrap_PyEval_AcquireThread(PyThreadState* state) {
  parked_if_unwound([=] { __real_PyEval_AcquireThread(state); });
}
void __wrap_PyEval_RestoreThread(PyThreadState* state) {
  parked_if_unwound([=] { __real_PyEval_RestoreThread(state); });
}
PyObject* __wrap_PyImport_ImportModule(const char* name) {
  return parked_if_unwound([=] { return __real_PyImport_ImportModule(name); });
}
PyObject* __wrap_PyObject_Vectorcall(PyObject* callable, PyObject* const* arguments, size_t count,
                                     PyObject* names) {
  return parked_if_unwound(
      [=] { return __real_PyObject_Vectorcall(callable, arguments, count, names); });
}
}
