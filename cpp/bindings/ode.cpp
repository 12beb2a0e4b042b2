#include <pybind11/complex.h>
#include <pybind11/stl.h>

#include "bindings.h"
#include "python_jacobian.h"
#include "python_system.h"
#include "substep/core/tableau.h"
#include "substep/ode/explicit/rkc_formula.h"
#include "substep/ode/implicit/jacobian.h"
#include "substep/ode/solve/integration.h"
#include "substep/ode/solve/methods.h"
#include "substep/ode/systems/catalogue.h"
#include "substep/ode/systems/pointer_system.h"

namespace {

namespace ode = substep::ode;
namespace tableaux = substep::tableaux;

py::array_t<double> vector_of(std::span<const double> values) {
  return py::array_t<double>(static_cast<py::ssize_t>(values.size()), values.data());
}

py::array_t<double> matrix(const double* values, std::size_t rows, std::size_t columns) {
  return py::array_t<double>({static_cast<py::ssize_t>(rows), static_cast<py::ssize_t>(columns)},
                             values);
}
template <std::size_t Rows, std::size_t Columns>
py::array_t<double> matrix(const double (&values)[Rows][Columns]) {
  return matrix(&values[0][0], Rows, Columns);
}

template <class T>
py::dict tableau_dict(const T&) {
  py::dict table;
  table["name"] = std::string(T::name);
  table["order"] = T::order;
  table["stages"] = T::stages;
  table["a"] = matrix(T::a);
  table["b"] = vector_of(T::b);
  table["c"] = vector_of(T::c);
  if constexpr (T::estimate != tableaux::Estimate::doubling) table["error_order"] = T::error_order;
  if constexpr (T::estimate == tableaux::Estimate::embedded) table["e"] = vector_of(T::e);
  if constexpr (T::estimate == tableaux::Estimate::dop853) {
    table["e3"] = vector_of(T::e3);
    table["e5"] = vector_of(T::e5);
  }
  if constexpr (T::dense_rows > 0) table["d"] = matrix(T::d);
  return table;
}

py::dict tableau(const std::string& method) {
  py::dict table;
  const auto look = [&](const auto&... t) {
    ((t.name == method ? (table = tableau_dict(t), 0) : 0), ...);
  };
  std::apply(look, tableaux::Methods{});
  std::apply(look, tableaux::ImplicitMethods{});
  if (table.empty()) throw py::key_error(method);
  return table;
}

py::dict method_dict(const std::string& name) {
  constexpr const char* kFamilies[] = {"explicit", "implicit", "stabilized"};
  for (const ode::Method& method : ode::methods()) {
    if (method.name != name) continue;
    py::dict properties;
    properties["family"] = kFamilies[static_cast<int>(method.family)];
    properties["order"] = method.order;
    properties["error_order"] = method.error_order;
    properties["doubling"] = method.doubling;
    return properties;
  }
  throw py::key_error(name);
}

py::dict rkc_formula(int stages) {
  const ode::RkcFormula formula(stages);
  py::dict constants;
  constants["w0"] = formula.w0();
  constants["w1"] = formula.w1();
  constants["a"] = formula.a();
  constants["b"] = formula.b();
  constants["c"] = [&] {
    py::array_t<double> c(stages);
    for (int j = 0; j < stages; ++j) c.mutable_data()[j] = formula.stage(j).c;
    return c;
  }();
  return constants;
}

// Moves rows of n doubles into an array (rows, n), or (rows, n / 2) of complex numbers.
py::array rows_array(std::vector<double>&& values, std::int64_t rows, std::int64_t n,
                     bool complex) {
  auto owned = std::make_unique<std::vector<double>>(std::move(values));
  double* data = owned->data();
  const py::capsule owner(owned.release(),
                          [](void* p) { delete static_cast<std::vector<double>*>(p); });
  if (!complex) return py::array_t<double>({rows, n}, data, owner);
  return py::array_t<std::complex<double>>({rows, n / 2},
                                           reinterpret_cast<std::complex<double>*>(data), owner);
}

// Calls one(t, out, stride) for each time; out is (n, len(t)).
template <class One>
py::array evaluate_at(const py::array_t<double, py::array::c_style>& t, std::int64_t n,
                      bool complex, One&& one) {
  const py::ssize_t count = t.size();
  std::vector<double> values(static_cast<std::size_t>(count * n));
  for (py::ssize_t i = 0; i < count; ++i) one(t.data()[i], values.data() + i * n);
  return rows_array(std::move(values), count, n, complex).attr("T").cast<py::array>();
}

// What Python holds of an integration; `complex` says how the doubles are to be read.
struct PyIntegration {
  ode::Integration integration;
  bool complex, native;

  std::int64_t size() { return integration.stepper().size(); }
  template <class Call>
  auto without_gil(Call&& call) {
    if (!native) return call();
    const py::gil_scoped_release release;
    return call();
  }
  py::array state(const double* y) {
    return rows_array(std::vector<double>(y, y + size()), 1, size(), complex)
        .reshape({complex ? size() / 2 : size()});
  }
};

struct PyDense {
  ode::DenseSolution dense;
  bool complex;
};

void check_size(const std::string& name, py::ssize_t size, const ode::System& system) {
  if (size == system.size()) return;
  throw substep::InputError(name + ": expected " + std::to_string(system.size()) +
                            " components, got " + std::to_string(size));
}

// df/dy of the system's own: an array (n, n), or (start, row, values) of its nonzeros by columns.
py::object jacobian(ode::System& system, double t,
                    const py::array_t<double, py::array::c_style>& y) {
  check_size("y", y.size(), system);
  const std::int64_t n = system.size();
  if (const substep::SparsePattern* pattern = system.jacobian_pattern()) {
    py::array_t<double> values(pattern->entries());
    system.jacobian(t, y.data(), values.mutable_data());
    return py::make_tuple(py::array(py::cast(pattern->start)), py::array(py::cast(pattern->row)),
                          values);
  }
  py::array_t<double> columns({n, n});
  system.jacobian(t, y.data(), columns.mutable_data());
  return columns.attr("T").attr("copy")();
}

// A number or a function of (t, y) as what RKC2 asks for; None: nothing.
std::function<double(double, const double*)> spectral_radius(const py::object& given,
                                                             std::int64_t size, bool complex) {
  if (given.is_none()) return {};
  if (PyFloat_Check(given.ptr())) {
    return [value = given.cast<double>()](double, const double*) { return value; };
  }
  return [given, size, complex](double t, const double* y) {
    py::array state = rows_array(std::vector<double>(y, y + size), 1, size, complex)
                          .reshape({complex ? size / 2 : size});
    return given(t, state).cast<double>();
  };
}

std::unique_ptr<PyIntegration> make_integration(
    std::shared_ptr<ode::System> system, const std::string& method, double t, double t_bound,
    const py::array& y0, double step, std::vector<double> rtol, std::vector<double> atol,
    double first_step, double max_step, int threads, bool every_step, std::vector<double> t_eval,
    bool dense, bool interpolate, const py::object& radius, std::shared_ptr<ode::Jacobian> jacobian,
    std::shared_ptr<ode::MassMatrix> mass, const std::string& linear_solver,
    bool local_extrapolation) {
  const bool complex = y0.dtype().kind() == 'c';
  const py::array_t<double, py::array::c_style> y =
      complex ? py::array(y0.attr("view")("float64")) : y0;
  check_size("y0", y.size(), *system);
  ode::StepOptions options;
  options.t = t;
  options.t_bound = t_bound;
  options.y = y.data();
  options.step = step;
  options.rtol = std::move(rtol);
  options.atol = std::move(atol);
  options.first_step = first_step;
  options.max_step = max_step;
  options.local_extrapolation = local_extrapolation;
  options.complex_pairs = complex;
  options.threads = threads;
  options.spectral_radius = spectral_radius(radius, system->size(), complex);
  options.jacobian = std::move(jacobian);
  options.mass = std::move(mass);
  options.linear_solver = linear_solver == "krylov"   ? ode::LinearSolver::krylov
                          : linear_solver == "direct" ? ode::LinearSolver::direct
                                                      : ode::LinearSolver::automatic;
  const bool native = system->native() && (!options.jacobian || options.jacobian->native()) &&
                      (radius.is_none() || PyFloat_Check(radius.ptr()));
  ode::Output output{every_step, std::move(t_eval), dense, interpolate};
  return std::unique_ptr<PyIntegration>(new PyIntegration{
      ode::Integration(std::move(system), method, options, std::move(output)), complex, native});
}

void bind_systems(py::module_& m) {
  using ode::System;
  py::class_<System, std::shared_ptr<System>>(m, "System")
      .def_property_readonly("size", &System::size)
      .def_property_readonly("native", &System::native)
      .def_property_readonly("second_order", &System::second_order)
      .def(
          "rhs",
          [](System& system, double t, const py::array_t<double, py::array::c_style>& y) {
            check_size("y", y.size(), system);
            py::array_t<double> dydt(y.size());
            system.rhs(t, y.data(), dydt.mutable_data());
            return dydt;
          },
          py::arg("t"), py::arg("y"))
      .def_property_readonly("has_jacobian", &System::has_jacobian)
      .def("jacobian", &jacobian, py::arg("t"), py::arg("y"))
      .def_property_readonly("has_jacobian_product", &System::has_jacobian_product)
      .def(
          "jacobian_product",
          [](System& system, double t, const py::array_t<double, py::array::c_style>& y,
             const py::array_t<double, py::array::c_style>& v) {
            check_size("y", y.size(), system);
            check_size("v", v.size(), system);
            py::array_t<double> out(v.size());
            system.jacobian_product(t, y.data(), v.data(), out.mutable_data());
            return out;
          },
          py::arg("t"), py::arg("y"), py::arg("v"));
  py::class_<PythonSystem, System, std::shared_ptr<PythonSystem>>(m, "PythonSystem")
      .def(py::init<py::object, std::int64_t, bool, const py::tuple&, py::object>(), py::arg("fun"),
           py::arg("components"), py::arg("complex"), py::arg("args"), py::arg("convert"));
  py::class_<ode::PointerSystem, System, std::shared_ptr<ode::PointerSystem>>(m, "PointerSystem")
      .def(py::init([](std::uintptr_t address, std::int64_t size, py::array_t<double> parameters) {
             return std::make_shared<ode::PointerSystem>(
                 reinterpret_cast<ode::PointerSystem::Function>(address), size,
                 const_cast<double*>(parameters.data()));
           }),
           py::keep_alive<1, 4>(), py::arg("address"), py::arg("size"), py::arg("parameters"));
  m.def(
      "make_system",
      [](const std::string& name, const std::vector<double>& parameters) {
        return ode::make_system(name, parameters);
      },
      py::arg("name"), py::arg("parameters"));
}

void bind_integration(py::module_& m) {
  using Times = py::array_t<double, py::array::c_style>;
  py::class_<PyDense>(m, "DenseSolution")
      .def_property_readonly("times",
                             [](const PyDense& d) { return Times(py::cast(d.dense.times)); })
      .def(
          "evaluate",
          [](const PyDense& d, const Times& t) {
            return evaluate_at(t, d.dense.size, d.complex,
                               [&](double at, double* out) { d.dense.evaluate(at, out, 1); });
          },
          py::arg("t"));
  py::class_<PyIntegration>(m, "Integration")
      .def(py::init(&make_integration), py::kw_only(), py::arg("system"), py::arg("method"),
           py::arg("t"), py::arg("t_bound"), py::arg("y0"), py::arg("step"), py::arg("rtol"),
           py::arg("atol"), py::arg("first_step"), py::arg("max_step"), py::arg("threads"),
           py::arg("every_step"), py::arg("t_eval"), py::arg("dense"), py::arg("interpolate"),
           py::arg("spectral_radius") = py::none(), py::arg("jacobian") = py::none(),
           py::arg("mass") = py::none(), py::arg("linear_solver") = "auto",
           py::arg("local_extrapolation") = true)
      .def("start",
           [](PyIntegration& i) { i.without_gil([&] { return i.integration.start(), 0; }); })
      .def(
          "run",
          [](PyIntegration& i, std::int64_t steps) {
            return i.without_gil([&] { return i.integration.run(steps); });
          },
          py::arg("steps"))
      .def(
          "interpolate",
          [](PyIntegration& i, const Times& t) {
            return evaluate_at(t, i.size(), i.complex,
                               [&](double at, double* out) { i.integration.interpolate(at, out); });
          },
          py::arg("t"))
      // The last step's polynomial, to keep.
      .def("step_dense",
           [](PyIntegration& i) { return PyDense{i.integration.step_dense(), i.complex}; })
      .def(
          "truncate", [](PyIntegration& i, double t) { i.integration.truncate(t); }, py::arg("t"))
      .def_property_readonly("t", [](PyIntegration& i) { return i.integration.stepper().t(); })
      .def_property_readonly("t_old",
                             [](PyIntegration& i) { return i.integration.stepper().t_old(); })
      .def_property_readonly("y",
                             [](PyIntegration& i) { return i.state(i.integration.stepper().y()); })
      .def_property_readonly(
          "y_old", [](PyIntegration& i) { return i.state(i.integration.stepper().y_old()); })
      .def_property_readonly("evaluations",
                             [](PyIntegration& i) { return i.integration.stepper().evaluations(); })
      .def_property_readonly("jacobians",
                             [](PyIntegration& i) { return i.integration.stepper().jacobians(); })
      .def_property_readonly(
          "factorizations",
          [](PyIntegration& i) { return i.integration.stepper().factorizations(); })
      .def_property_readonly("steps",
                             [](PyIntegration& i) { return i.integration.stepper().steps(); })
      .def_property_readonly("finished",
                             [](PyIntegration& i) { return i.integration.stepper().finished(); })
      // What was recorded, handed over once.
      .def("take_times",
           [](PyIntegration& i) {
             auto& times = i.integration.times();
             const auto count = static_cast<std::int64_t>(times.size());
             return rows_array(std::move(times), 1, count, false).reshape({count});
           })
      .def("take_states",
           [](PyIntegration& i) {
             auto& states = i.integration.states();
             const auto count = static_cast<std::int64_t>(states.size());
             const std::int64_t rows = i.size() > 0 ? count / i.size() : 0;
             return rows_array(std::move(states), rows, i.size(), i.complex);
           })
      .def("take_dense",
           [](PyIntegration& i) { return PyDense{std::move(i.integration.dense()), i.complex}; });
}

}  // namespace

void bind_ode(py::module_& m) {
  m.def("ode_methods", [] {
    py::list names;
    for (const ode::Method& method : ode::methods()) names.append(std::string(method.name));
    return names;
  });
  m.def("rkc_formula", &rkc_formula, py::arg("stages"));
  m.def("ode_method", &method_dict, py::arg("name"));
  m.def("tableau", &tableau, py::arg("method"));
  bind_systems(m);
  bind_jacobians(m);
  bind_integration(m);
}
