// One bind_* function per method folder; module.cpp calls them all. Names, shapes and casts only.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

namespace py = pybind11;

void bind_batch(py::module_& m);
void bind_core(py::module_& m);
void bind_fields(py::module_& m);
void bind_geometry(py::module_& m);
void bind_grid_flow(py::module_& m);
void bind_grid_liquid(py::module_& m);
void bind_linalg(py::module_& m);
void bind_mpm(py::module_& m);
void bind_neighbours(py::module_& m);
void bind_ode(py::module_& m);
void bind_owner(py::module_& m);
void bind_particle_flow(py::module_& m);
void bind_pbf(py::module_& m);
void bind_pbd(py::module_& m);
void bind_pbd_constraints(py::module_& m);
void bind_rigid(py::module_& m);
void bind_rigid_world(py::module_& m);
void bind_second_order(py::module_& m);
void bind_soft_body(py::module_& m);
void bind_springs(py::module_& m);

void guard_construction(py::module_& m);
