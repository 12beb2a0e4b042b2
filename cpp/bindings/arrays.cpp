#include "arrays.h"

#include "substep/core/errors.h"

using substep::geometry::Vec3;

double number(const py::dict& options, const char* name) { return options[name].cast<double>(); }
int integer(const py::dict& options, const char* name) { return options[name].cast<int>(); }
bool flag(const py::dict& options, const char* name) { return options[name].cast<bool>(); }
std::string word(const py::dict& options, const char* name) {
  return options[name].cast<std::string>();
}
Vec3 vector(const py::dict& options, const char* name) {
  const py::sequence v = options[name];
  return {v[0].cast<double>(), v[1].cast<double>(), v[2].cast<double>()};
}

Reals table(const std::vector<double>& values, const Sizes& row) {
  py::ssize_t width = 1;
  for (const py::ssize_t k : row) width *= k;
  Sizes shape = row;
  shape.insert(shape.begin(), static_cast<py::ssize_t>(values.size()) / width);
  return made(Reals(std::move(shape), values.data()));
}

py::array rows(const substep::Numbers& values, py::ssize_t columns) {
  return std::visit(
      [&](const auto& v) -> py::array {
        if (columns == 0) return column(v);
        return table(v, columns);
      },
      values);
}

substep::Numbers numbers(const py::array& values) {
  if (py::isinstance<Array<float>>(values)) return list(Array<float>(values));
  if (py::isinstance<Reals>(values)) return list(Reals(values));
  throw substep::InputError("state: expected C-contiguous float32 or float64");
}

substep::NumbersIn readable(const py::array& values) {
  const auto n = static_cast<std::size_t>(values.size());
  if (py::isinstance<Array<float>>(values))
    return std::span(static_cast<const float*>(values.data()), n);
  if (py::isinstance<Reals>(values)) return std::span(static_cast<const double*>(values.data()), n);
  throw py::type_error("expected a C-contiguous array of float32 or float64");
}

substep::NumbersOut writable(py::array& values) {
  const auto n = static_cast<std::size_t>(values.size());
  if (py::isinstance<Array<float>>(values))
    return std::span(static_cast<float*>(values.mutable_data()), n);
  if (py::isinstance<Reals>(values))
    return std::span(static_cast<double*>(values.mutable_data()), n);
  throw py::type_error("expected a C-contiguous array of float32 or float64");
}

py::array empty_like(const py::array& values) {
  return py::array(values.dtype(), Sizes(values.shape(), values.shape() + values.ndim()));
}

substep::Precision precision(const std::string& dtype) {
  return dtype == "float32" ? substep::Precision::kSingle : substep::Precision::kDouble;
}

std::span<const std::int64_t> rows_in(const LongIndices& rows, std::int64_t count) {
  const auto all = readable(rows);
  for (const std::int64_t row : all) check_row(row, count);
  return all;
}

void check_row(std::int64_t row, std::int64_t count) {
  if (row < 0 || row >= count)
    throw substep::InputError("there is no row " + std::to_string(row) + " of " +
                              std::to_string(count) + "; were some taken out during the call?");
}

Points::Points(const Reals& rows) {
  static_assert(sizeof(Vec3) == 3 * sizeof(double));
  const auto n = static_cast<std::size_t>(rows.shape(0));
  const double* from = rows.data();
  if (rows.shape(1) == 3) {
    all_ = {reinterpret_cast<const Vec3*>(from), n};
    return;
  }
  in_plane_.reserve(n);
  for (std::size_t i = 0; i < n; ++i) in_plane_.emplace_back(from[2 * i], from[2 * i + 1], 0.0);
  all_ = in_plane_;
}
