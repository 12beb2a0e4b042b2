// Objects of Python that are made when memory has run out.
//
// pybind11 notes each object with the address of its native part, which takes a little memory.
// Where there is none, it frees the native part twice (once as that of the object, once as what it
// was made from), and in constructors std::bad_alloc leaves the function that Python has called,
// which ends the process. Both are set right here, for all classes of the module.
#include <pybind11/detail/class.h>

#include <new>
#include <unordered_map>

#include "bindings.h"

namespace {

using py::detail::instance;
using py::detail::type_info;

using Noting = void (*)(instance*, const void*);
std::unordered_map<const type_info*, Noting> notings;  // pybind11's own

void note(instance* object, const void* holder) {
  const type_info* type = py::detail::get_type_info(Py_TYPE(object));
  try {
    notings.at(type)(object, holder);
  } catch (...) {
    auto part = object->get_value_and_holder(type);
    if (!part.holder_constructed()) {
      if (part.instance_registered()) {
        py::detail::deregister_instance(object, part.value_ptr(), type);
        part.set_instance_registered(false);
      }
      // Whoever gave a holder frees the native part; without one, what it has beside its own bytes
      // would be lost with these anyway.
      part.value_ptr() = nullptr;
    }
    throw;
  }
}

// What Python calls, with std::bad_alloc made MemoryError.
template <class... Arguments>
struct Guarded {
  using Function = PyObject* (*)(Arguments...);
  static inline Function function = nullptr;  // one for all: pybind11's dispatcher

  static PyObject* call(Arguments... arguments) {
    try {
      return function(arguments...);
    } catch (const std::bad_alloc&) {
      return PyErr_NoMemory();
    }
  }
  static void guard(PyMethodDef& method) {
    function = reinterpret_cast<Function>(reinterpret_cast<void (*)()>(method.ml_meth));
    method.ml_meth = reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(&call));
  }
};

void guard_constructor(py::handle type) {
  const py::object dictionary = type.attr("__dict__");
  if (!dictionary.contains("__init__")) return;
  PyObject* made = py::object(dictionary["__init__"]).ptr();
  if (PyInstanceMethod_Check(made)) made = PyInstanceMethod_Function(made);
  if (!PyCFunction_Check(made)) return;
  PyMethodDef& method = *reinterpret_cast<PyCFunctionObject*>(made)->m_ml;
  if (method.ml_flags & METH_FASTCALL) {
    Guarded<PyObject*, PyObject* const*, Py_ssize_t, PyObject*>::guard(method);
  } else {
    Guarded<PyObject*, PyObject*, PyObject*>::guard(method);
  }
}

}  // namespace

void guard_construction(py::module_& m) {
  for (const auto& [name, value] : m.attr("__dict__").cast<py::dict>()) {
    if (!PyType_Check(value.ptr())) continue;
    auto* python_type = reinterpret_cast<PyTypeObject*>(value.ptr());
    if (Py_TYPE(python_type) != py::detail::get_internals().default_metaclass) continue;
    type_info* type = py::detail::get_type_info(python_type);
    if (!type || notings.contains(type)) continue;
    notings[type] = type->init_instance;
    type->init_instance = note;
    guard_constructor(value);
  }
}
