// Who uses a simulation: one call at a time, and the callback of that call.
#include <array>
#include <string>
#include <utility>

#include "bindings.h"
#include "substep/core/errors.h"

namespace {

// Native, because Python runs handlers of signals between its own instructions: a KeyboardInterrupt
// between the taking and the `with` that lets go would leave a simulation taken for good.
class Owner {
 public:
  explicit Owner(std::string name) : name_(std::move(name)) {}

  bool taken() const { return taken_; }

  void enter() {
    if (in_callback()) return;
    if (taken_) {
      throw substep::InputError("this " + name_ +
                                " is in use by another thread, or by a function that it calls");
    }
    taken_ = true;
  }

  void leave() {
    if (!in_callback()) taken_ = false;
  }

  void refuse_callback(const char* method) const {
    if (in_callback()) {
      throw substep::InputError(std::string(method) + ": called by the callback of advance");
    }
  }

  // callback(simulation), which may use what this call has taken.
  void call(const py::object& callback, const py::object& simulation) {
    const std::array<PyObject*, 2> arguments{nullptr, simulation.ptr()};
    callback_ = PyThread_get_thread_ident();
    const auto result = py::reinterpret_steal<py::object>(PyObject_Vectorcall(
        callback.ptr(), arguments.data() + 1, 1 | PY_VECTORCALL_ARGUMENTS_OFFSET, nullptr));
    callback_ = 0;
    if (!result) throw py::error_already_set();
  }

 private:
  bool in_callback() const { return callback_ != 0 && callback_ == PyThread_get_thread_ident(); }

  std::string name_;
  bool taken_ = false;          // with the GIL, as all here
  unsigned long callback_ = 0;  // the thread that runs a callback
};

}  // namespace

void bind_owner(py::module_& m) {
  py::class_<Owner>(m, "Owner")
      .def(py::init<std::string>(), py::arg("name"))
      .def_property_readonly("taken", &Owner::taken)
      .def("__enter__", &Owner::enter)
      .def("__exit__", [](Owner& self, py::handle, py::handle, py::handle) { self.leave(); })
      .def("refuse_callback", &Owner::refuse_callback, py::arg("method"))
      .def("call", &Owner::call, py::arg("callback"), py::arg("simulation"));
}
