#include <pybind11/complex.h>
#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/core/errors.h"
#include "substep/linalg/direct/cholesky.h"
#include "substep/linalg/direct/library_calls.h"
#include "substep/linalg/direct/lu.h"
#include "substep/linalg/krylov.h"
#include "substep/linalg/preconditioners.h"

namespace {

using namespace substep;

// The Python layer has checked the shapes.
template <class T>
std::span<const T> view(const Array<T>& array) {
  return {array.data(), static_cast<std::size_t>(array.size())};
}

SparsePattern make_pattern(const Indices& start, const Indices& row) {
  const auto n = static_cast<std::int32_t>(start.size() - 1);
  SparsePattern pattern{
      n, n, {start.data(), start.data() + start.size()}, {row.data(), row.data() + row.size()}};
  check_pattern(pattern);
  return pattern;
}

const std::vector<std::pair<std::string, Ordering>> kOrderings{{"automatic", Ordering::automatic},
                                                               {"amd", Ordering::amd},
                                                               {"metis", Ordering::metis},
                                                               {"natural", Ordering::natural}};
const std::vector<std::pair<std::string, CholeskyKind>> kCholeskyKinds{
    {"automatic", CholeskyKind::automatic},
    {"simplicial", CholeskyKind::simplicial},
    {"supernodal", CholeskyKind::supernodal}};
const std::vector<std::pair<std::string, LUKind>> kLUKinds{
    {"automatic", LUKind::automatic}, {"umfpack", LUKind::umfpack}, {"klu", LUKind::klu}};

template <class Value>
Value value_of(const std::vector<std::pair<std::string, Value>>& names, const std::string& name) {
  for (const auto& [known, value] : names) {
    if (known == name) return value;
  }
  throw InputError("unknown name " + name);
}

template <class Value>
std::string name_of(const std::vector<std::pair<std::string, Value>>& names, Value wanted) {
  for (const auto& [name, value] : names) {
    if (value == wanted) return name;
  }
  return "";
}

// Right-hand sides are the rows of b.
template <class T, class Factor>
Array<T> solve_rows(const Array<T>& b, const Factor& solve) {
  Array<T> x(std::vector<py::ssize_t>(b.shape(), b.shape() + b.ndim()));
  const std::span<T> out{x.mutable_data(), static_cast<std::size_t>(x.size())};
  const auto columns = static_cast<std::int32_t>(b.ndim() == 2 ? b.shape(0) : 1);
  const py::gil_scoped_release release;
  solve(view(b), out, columns);
  return x;
}

void bind_cholesky(py::module_& m) {
  py::class_<Cholesky>(m, "CholeskyFactor")
      .def(py::init([](const Indices& start, const Indices& row, const std::string& ordering,
                       const std::string& kind, std::int32_t block) {
             const SparsePattern pattern = make_pattern(start, row);
             const CholeskyOptions options{value_of(kOrderings, ordering),
                                           value_of(kCholeskyKinds, kind), block};
             const py::gil_scoped_release release;
             return Cholesky(lower_triangle(pattern), options);
           }),
           py::arg("start"), py::arg("row"), py::arg("ordering"), py::arg("kind"), py::arg("block"))
      .def(
          "factor",
          [](Cholesky& self, const Array<double>& values) {
            const py::gil_scoped_release release;
            return self.factor(view(values)).factorized;
          },
          py::arg("values"))
      .def(
          "solve",
          [](Cholesky& self, const Array<double>& b) {
            return solve_rows(b, [&](auto in, auto out, auto n) { self.solve(in, out, n); });
          },
          py::arg("b"))
      .def("report", [](const Cholesky& self) {
        const CholeskyReport& report = self.report();
        py::dict entries;
        entries["positive_definite"] = report.factorized;
        entries["column"] = report.column;
        entries["kind"] = report.supernodal ? "supernodal" : "simplicial";
        entries["ordering"] = name_of(kOrderings, report.ordering);
        entries["factor_entries"] = report.factor_entries;
        entries["flops"] = report.flops;
        entries["analyses"] = report.analyses;
        entries["factorizations"] = report.factorizations;
        return entries;
      });
}

template <class T>
void bind_lu(py::module_& m, const char* name) {
  py::class_<LU<T>>(m, name)
      .def(py::init([](const Indices& start, const Indices& row, const std::string& kind) {
             SparsePattern pattern = make_pattern(start, row);
             const LUKind chosen = value_of(kLUKinds, kind);
             const py::gil_scoped_release release;
             return LU<T>(std::move(pattern), chosen);
           }),
           py::arg("start"), py::arg("row"), py::arg("kind"))
      .def(
          "factor",
          [](LU<T>& self, const Array<T>& values) {
            const py::gil_scoped_release release;
            self.factor(view(values));
          },
          py::arg("values"))
      .def(
          "solve",
          [](LU<T>& self, const Array<T>& b, bool transpose) {
            return solve_rows(
                b, [&](auto in, auto out, auto n) { self.solve(in, out, n, transpose); });
          },
          py::arg("b"), py::arg("transpose"))
      .def("report", [](const LU<T>& self) {
        const LUReport& report = self.report();
        py::dict entries;
        entries["kind"] = name_of(kLUKinds, report.kind);
        entries["factor_entries"] = report.factor_entries;
        entries["rcond"] = report.rcond;
        entries["analyses"] = report.analyses;
        entries["factorizations"] = report.factorizations;
        return entries;
      });
}

// A Python function y = f(x) as an operator. Called on the thread that solves.
template <class T>
LinearOperator<T> python_operator(const py::function& function) {
  return [&function](std::span<const T> x, std::span<T> y) {
    const py::gil_scoped_acquire gil;
    Array<T> argument(static_cast<py::ssize_t>(x.size()), x.data());
    const auto answer = Array<T>::ensure(function(std::move(argument)));
    if (!answer) throw py::error_already_set();
    std::copy_n(answer.data(), y.size(), y.data());
  };
}

// A is a callable or its columns; M is a callable or a name.
template <class T>
py::tuple solve_krylov(bool symmetric, const py::object& a, const py::object& preconditioner,
                       const Array<T>& b, const Array<T>& guess, const KrylovOptions& options) {
  LinearOperator<T> product, m;
  SparsePattern pattern;
  std::vector<T> values;
  if (py::isinstance<py::function>(a)) {
    product = python_operator<T>(*reinterpret_cast<const py::function*>(&a));
  } else {
    const auto [start, row, data] = a.cast<std::tuple<Indices, Indices, Array<T>>>();
    pattern = make_pattern(start, row);
    values.assign(data.data(), data.data() + data.size());
    if (!symmetric) {  // products run along the rows
      std::vector<std::int32_t> entry;
      pattern = transposed(pattern, &entry);
      std::vector<T> flipped(values.size());
      for (std::size_t k = 0; k < entry.size(); ++k) {
        flipped[k] = values[static_cast<std::size_t>(entry[k])];
      }
      values = std::move(flipped);
    }
    product = [&](std::span<const T> x, std::span<T> y) {
      multiply_transposed<T>(pattern, values, x, y, options.threads);
    };
  }
  if (py::isinstance<py::function>(preconditioner)) {
    m = python_operator<T>(*reinterpret_cast<const py::function*>(&preconditioner));
  } else {
    const auto name = preconditioner.cast<std::string>();
    std::vector<std::int32_t> entry;
    std::vector<T> part;
    if (name == "diagonal") {
      m = diagonal_preconditioner<T>(pattern, values, options.threads);
    } else if (name == "incomplete") {
      const SparsePattern shape =
          symmetric ? lower_triangle(pattern, &entry) : transposed(pattern, &entry);
      for (const std::int32_t k : entry) part.push_back(values[static_cast<std::size_t>(k)]);
      if constexpr (std::is_same_v<T, double>) {
        m = symmetric ? incomplete_cholesky(shape, part) : incomplete_lu<T>(shape, part);
      } else {
        m = incomplete_lu<T>(shape, part);
      }
    }
  }
  Array<T> x(guess.size(), guess.data());
  const std::span<T> out{x.mutable_data(), static_cast<std::size_t>(x.size())};
  KrylovReport report;
  {
    const py::gil_scoped_release release;
    if constexpr (std::is_same_v<T, double>) {
      report = symmetric ? cg(product, view(b), out, options, m)
                         : bicgstab<T>(product, view(b), out, options, m);
    } else {
      report = bicgstab<T>(product, view(b), out, options, m);
    }
  }
  return py::make_tuple(x, report.converged, report.iterations, report.residuals, report.remedy);
}

}  // namespace

void bind_linalg(py::module_& m) {
  bind_cholesky(m);
  bind_lu<double>(m, "LUFactor");
  bind_lu<std::complex<double>>(m, "ComplexLUFactor");
  m.def(
      "krylov",
      [](bool symmetric, const py::object& a, const py::object& preconditioner, const py::object& b,
         const py::object& guess, double rtol, double atol, std::int32_t max_iterations,
         int threads) -> py::tuple {
        const KrylovOptions options{rtol, atol, max_iterations, threads};
        if (py::isinstance<Array<std::complex<double>>>(b)) {
          return solve_krylov<std::complex<double>>(
              symmetric, a, preconditioner, b.cast<Array<std::complex<double>>>(),
              guess.cast<Array<std::complex<double>>>(), options);
        }
        return solve_krylov<double>(symmetric, a, preconditioner, b.cast<Array<double>>(),
                                    guess.cast<Array<double>>(), options);
      },
      py::arg("symmetric"), py::arg("a"), py::arg("preconditioner"), py::arg("b"), py::arg("guess"),
      py::arg("rtol"), py::arg("atol"), py::arg("max_iterations"), py::arg("threads"));
  m.def(
      "find_asymmetry",
      [](const Indices& start, const Indices& row, const Array<double>& values, double tolerance) {
        return find_asymmetry(make_pattern(start, row), view(values), tolerance);
      },
      py::arg("start"), py::arg("row"), py::arg("values"), py::arg("tolerance"));
  m.def("library_versions", [] {
    const LibraryVersions versions = library_versions();
    py::dict entries;
    entries["suitesparse"] = versions.suitesparse;
    entries["blas"] = versions.blas;
    entries["blas_is_serial"] = versions.blas_is_serial;
    entries["blas_is_reentrant"] = versions.blas_is_reentrant;
    entries["gpl"] = versions.gpl;
    return entries;
  });
}
