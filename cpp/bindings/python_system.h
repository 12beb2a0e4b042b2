// A right-hand side written in Python. Per call: one vectorcall, one copy in, one copy out.
#pragma once

#include <vector>

#include "bindings.h"
#include "substep/ode/stepping/system.h"

class PythonSystem final : public substep::ode::System {
 public:
  // fun(t, y, *args) -> dydt; y has `components` real or complex numbers. What is neither a plain
  // array nor a plain list goes to convert(value), which returns the array or raises.
  PythonSystem(py::object fun, std::int64_t components, bool complex, const py::tuple& args,
               py::object convert);

  std::int64_t size() const override { return complex_ ? 2 * components_ : components_; }
  bool native() const override { return false; }
  void rhs(double t, const double* y, double* dydt) override;

 private:
  void lend(const double* y);
  bool copy_array(PyObject* value, double* dydt) const;
  bool copy_sequence(PyObject* value, double* dydt) const;

  py::object fun_, convert_;
  std::int64_t components_;
  bool complex_;
  py::dtype dtype_;
  std::vector<py::object> args_;
  std::vector<PyObject*> call_;  // a free slot, t, y, args...
  py::object y_;                 // array, read-only, reused while nobody else holds it
};
