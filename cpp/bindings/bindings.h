// One bind_* function per method folder; module.cpp calls them all. Names, shapes and casts only.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

namespace py = pybind11;

void bind_core(py::module_& m);
void bind_ode(py::module_& m);
