#include <pthread.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <atomic>
#include <cstdint>
#include <utility>

#include "bindings.h"
#include "owner.h"
#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"

namespace {

// Python runs signal handlers in its main thread only: the one of the import's interpreter or, in
// the child of a fork, the one that forked.
std::atomic<unsigned long> main_thread{0};
[[maybe_unused]] const int registered =
    pthread_atfork(nullptr, nullptr, [] { main_thread = PyThread_get_thread_ident(); });

// Runs with or without the GIL held; throws the KeyboardInterrupt (or whatever a handler raised).
void check_signals() {
  if (PyThread_get_thread_ident() != main_thread.load(std::memory_order_relaxed)) return;
  const py::gil_scoped_acquire gil;
  const InUserFunction handler;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

thread_local std::int64_t polls_left = 0;

void count_poll() {
  if (--polls_left > 0) return;
  substep::set_poll_hook(nullptr);
  const py::gil_scoped_acquire gil;
  PyErr_SetNone(PyExc_KeyboardInterrupt);
  throw py::error_already_set();
}

// For tests: the polls-th poll of this thread from now on raises KeyboardInterrupt, as Ctrl-C just
// then would; 0: none does. Returns how many were left of those of the last call.
std::int64_t interrupt_after(std::int64_t polls) {
  substep::set_poll_hook(polls > 0 ? &count_poll : nullptr);
  return std::exchange(polls_left, polls);
}

// Sets substep.errors.<name>(message, time=, index=, step=) as the Python error.
void raise(const char* name, const substep::SolverError& error, py::dict where = {}) {
  const py::object type = py::module_::import("substep.errors").attr(name);
  if (std::isfinite(error.time)) where["time"] = error.time;
  if (error.index >= 0) where["index"] = error.index;
  if (error.step >= 0) where["step"] = error.step;
  py::set_error(type, type(error.what(), **where));
}

void translate(std::exception_ptr pointer) {
  using namespace substep;
  try {
    std::rethrow_exception(pointer);
  } catch (const InputError& error) {
    py::set_error(py::module_::import("substep.errors").attr("InputError"), error.what());
  } catch (const NonFiniteError& error) {
    raise("NonFiniteError", error);
  } catch (const ConvergenceError& error) {
    raise("ConvergenceError", error, py::dict(py::arg("residuals") = error.residuals));
  } catch (const SingularMatrixError& error) {
    raise("SingularMatrixError", error);
  } catch (const SolverError& error) {
    raise("SolverError", error);
  }
}

}  // namespace

void bind_core(py::module_& m) {
  main_thread =
      py::module_::import("threading").attr("main_thread")().attr("ident").cast<unsigned long>();
  substep::set_interrupt_hook(&check_signals);
  py::register_local_exception_translator(&translate);
  m.def("interrupt_after", &interrupt_after, py::arg("polls"));
  m.attr("compiler") = __VERSION__;
  m.attr("eigen") = std::to_string(EIGEN_WORLD_VERSION) + "." +
                    std::to_string(EIGEN_MAJOR_VERSION) + "." + std::to_string(EIGEN_MINOR_VERSION);
  m.def("num_threads", &substep::num_threads);
  m.def("set_num_threads", &substep::set_num_threads, py::arg("threads"));
}
