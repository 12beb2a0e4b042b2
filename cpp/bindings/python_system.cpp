#include "python_system.h"

#include <cstring>

namespace {
using py::detail::array_proxy;
using py::detail::npy_api;
}  // namespace

PythonSystem::PythonSystem(py::object fun, std::int64_t components, bool complex,
                           const py::tuple& args, py::object convert)
    : fun_(std::move(fun)),
      convert_(std::move(convert)),
      components_(components),
      complex_(complex),
      dtype_(complex ? py::dtype::of<std::complex<double>>() : py::dtype::of<double>()),
      call_(3, nullptr) {
  for (const py::handle arg : args) {
    args_.push_back(py::reinterpret_borrow<py::object>(arg));
    call_.push_back(arg.ptr());
  }
}

void PythonSystem::rhs(double t, const double* y, double* dydt) {
  lend(y);
  const py::float_ time(t);
  call_[1] = time.ptr();
  call_[2] = y_.ptr();
  const auto result = py::reinterpret_steal<py::object>(PyObject_Vectorcall(
      fun_.ptr(), call_.data() + 1, (call_.size() - 1) | PY_VECTORCALL_ARGUMENTS_OFFSET, nullptr));
  if (!result) throw py::error_already_set();
  if (copy_array(result.ptr(), dydt) || copy_sequence(result.ptr(), dydt)) return;
  const py::object converted = convert_(result);
  if (!copy_array(converted.ptr(), dydt)) throw py::type_error("fun: the converter failed");
}

// Copies y into the array that f sees: the one of the last call unless f kept it, or a view of it.
void PythonSystem::lend(const double* y) {
  if (!y_ || Py_REFCNT(y_.ptr()) != 1) {
    y_ = py::array(dtype_, static_cast<py::ssize_t>(components_));
    array_proxy(y_.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  }
  if (size() > 0) {
    std::memcpy(array_proxy(y_.ptr())->data, y, sizeof(double) * static_cast<std::size_t>(size()));
  }
}

bool PythonSystem::copy_array(PyObject* value, double* dydt) const {
  if (!npy_api::get().PyArray_Check_(value)) return false;
  const auto* array = array_proxy(value);
  constexpr int kPlain = npy_api::NPY_ARRAY_C_CONTIGUOUS_ | npy_api::NPY_ARRAY_ALIGNED_;
  if (Py_TYPE(value) != npy_api::get().PyArray_Type_ || array->descr != dtype_.ptr() ||
      (array->flags & kPlain) != kPlain || array->nd != 1 || array->dimensions[0] != components_) {
    return false;
  }
  if (size() > 0) {
    std::memcpy(dydt, array->data, sizeof(double) * static_cast<std::size_t>(size()));
  }
  return true;
}

// Lists and tuples of floats (numpy.float64 is one) and integers; for complex y the rest is left
// to the converter.
bool PythonSystem::copy_sequence(PyObject* value, double* dydt) const {
  if (complex_ || !(PyList_CheckExact(value) || PyTuple_CheckExact(value))) return false;
  if (PySequence_Fast_GET_SIZE(value) != components_) return false;
  PyObject** items = PySequence_Fast_ITEMS(value);
  for (std::int64_t i = 0; i < components_; ++i) {
    if (PyFloat_Check(items[i])) {
      dydt[i] = PyFloat_AS_DOUBLE(items[i]);
    } else if (PyLong_CheckExact(items[i])) {
      dydt[i] = PyLong_AsDouble(items[i]);
      if (dydt[i] == -1.0 && PyErr_Occurred()) throw py::error_already_set();
    } else {
      return false;
    }
  }
  return true;
}
