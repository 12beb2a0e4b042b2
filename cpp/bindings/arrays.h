// What crosses the border to NumPy in many files: vectors, rows and columns of numbers.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "bindings.h"
#include "substep/core/numbers.h"
#include "substep/geometry/vectors.h"

template <class T>
using Array = py::array_t<T, py::array::c_style>;
using Reals = Array<double>;
using Indices = Array<std::int32_t>;
using LongIndices = Array<std::int64_t>;
using Sizes = std::vector<py::ssize_t>;
using Triple = std::array<double, 3>;

inline substep::geometry::Vec3 vector(const Triple& a) { return {a[0], a[1], a[2]}; }
inline Triple triple(const substep::geometry::Vec3& a) { return {a[0], a[1], a[2]}; }

// Of a dictionary of options.
double number(const py::dict& options, const char* name);
int integer(const py::dict& options, const char* name);
bool flag(const py::dict& options, const char* name);
std::string word(const py::dict& options, const char* name);
substep::geometry::Vec3 vector(const py::dict& options, const char* name);

// The numbers of an array, as long as it lives.
template <class T>
std::span<const T> readable(const Array<T>& a) {
  return {a.data(), static_cast<std::size_t>(a.size())};
}
template <class T>
std::span<T> writable(Array<T>& a) {
  return {a.mutable_data(), static_cast<std::size_t>(a.size())};
}
template <class T>
std::vector<T> list(const Array<T>& a) {
  return {a.data(), a.data() + a.size()};
}
// A new array. Where memory runs out while pybind11 copies numbers into it, it is none.
template <class A>
A made(A array) {
  if (!array) throw py::error_already_set();
  return array;
}
// Arrays with copies of the numbers.
template <class T>
Array<T> column(const std::vector<T>& values) {
  return made(Array<T>(static_cast<py::ssize_t>(values.size()), values.data()));
}
template <class T>
Array<T> table(const std::vector<T>& values, py::ssize_t columns) {
  return made(
      Array<T>({static_cast<py::ssize_t>(values.size()) / columns, columns}, values.data()));
}
Reals table(const std::vector<double>& values, const Sizes& row);

// Numbers of either precision: rows of so many columns, or flat (0).
py::array rows(const substep::Numbers& values, py::ssize_t columns);
substep::Numbers numbers(const py::array& values);
substep::Precision precision(const std::string& dtype);
// The numbers of an array as long as it lives, and a new one of its shape and precision.
substep::NumbersIn readable(const py::array& values);
substep::NumbersOut writable(py::array& values);
py::array empty_like(const py::array& values);

// Rows of an object that has so many, or InputError: after Python has found them, a handler of
// signals, or what converts another argument, may have taken some out.
std::span<const std::int64_t> rows_in(const LongIndices& rows, std::int64_t count);
void check_row(std::int64_t row, std::int64_t count);

// Rows of three numbers as they lie in an array, as long as that lives; copies of rows of two, with
// z = 0.
class Points {
 public:
  explicit Points(const Reals& rows);
  Points(const Points&) = delete;
  Points& operator=(const Points&) = delete;

  operator std::span<const substep::geometry::Vec3>() const { return all_; }
  std::vector<substep::geometry::Vec3> copied() const { return {all_.begin(), all_.end()}; }

 private:
  std::vector<substep::geometry::Vec3> in_plane_;
  std::span<const substep::geometry::Vec3> all_;
};
