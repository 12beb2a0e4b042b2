#include "bindings.h"
#include "substep/ode/tableau.h"

namespace {

namespace ode = substep::ode;

template <std::size_t Rows>
py::array_t<double> vector(const double (&values)[Rows]) {
  return py::array_t<double>(static_cast<py::ssize_t>(Rows), values);
}

template <std::size_t Rows, std::size_t Columns>
py::array_t<double> matrix(const double (&values)[Rows][Columns]) {
  return py::array_t<double>({static_cast<py::ssize_t>(Rows), static_cast<py::ssize_t>(Columns)},
                             &values[0][0]);
}

template <class T>
py::dict tableau_dict(const T&) {
  py::dict table;
  table["name"] = std::string(T::name);
  table["order"] = T::order;
  table["stages"] = T::stages;
  table["a"] = matrix(T::a);
  table["b"] = vector(T::b);
  table["c"] = vector(T::c);
  if constexpr (T::estimate != ode::Estimate::doubling) table["error_order"] = T::error_order;
  if constexpr (T::estimate == ode::Estimate::embedded) table["e"] = vector(T::e);
  if constexpr (T::estimate == ode::Estimate::dop853) {
    table["e3"] = vector(T::e3);
    table["e5"] = vector(T::e5);
  }
  if constexpr (T::dense_rows > 0) table["d"] = matrix(T::d);
  return table;
}

py::dict tableau(const std::string& method) {
  py::dict table;
  std::apply(
      [&](const auto&... t) { ((t.name == method ? (table = tableau_dict(t), 0) : 0), ...); },
      ode::Methods{});
  if (table.empty()) throw py::key_error(method);
  return table;
}

}  // namespace

void bind_ode(py::module_& m) {
  m.def("ode_methods", [] {
    py::list names;
    std::apply([&](const auto&... t) { (names.append(std::string(t.name)), ...); }, ode::Methods{});
    return names;
  });
  m.def("tableau", &tableau, py::arg("method"));
}
