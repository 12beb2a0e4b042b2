#include "python_jacobian.h"

#include <complex>

namespace {

namespace ode = substep::ode;
using CastIndices = py::array_t<std::int32_t, py::array::c_style | py::array::forcecast>;
using Values = py::array_t<double, py::array::c_style | py::array::forcecast>;

// None, or (start, row) of the columns.
std::unique_ptr<substep::SparsePattern> make_pattern(const py::object& columns) {
  if (columns.is_none()) return nullptr;
  const auto pair = columns.cast<std::pair<CastIndices, CastIndices>>();
  auto pattern = std::make_unique<substep::SparsePattern>();
  pattern->start.assign(pair.first.data(), pair.first.data() + pair.first.size());
  pattern->row.assign(pair.second.data(), pair.second.data() + pair.second.size());
  pattern->rows = pattern->cols = static_cast<std::int32_t>(pattern->start.size()) - 1;
  check_pattern(*pattern);
  return pattern;
}

std::vector<double> copy(const Values& values) {
  return {values.data(), values.data() + values.size()};
}

class ConstantJacobian final : public ode::Jacobian {
 public:
  ConstantJacobian(const py::object& columns, const Values& values)
      : pattern_(make_pattern(columns)), values_(copy(values)) {}

  const substep::SparsePattern* pattern() const override { return pattern_.get(); }
  bool constant() const override { return true; }
  std::int64_t evaluate(const ode::JacobianPoint&, std::vector<double>& values) override {
    values = values_;
    return 0;
  }

 private:
  std::unique_ptr<const substep::SparsePattern> pattern_;
  std::vector<double> values_;
};

// function(t, y) returns (columns, values) as the constructor above takes them.
class PythonJacobian final : public ode::Jacobian {
 public:
  PythonJacobian(py::object function, const py::object& columns, std::int64_t components,
                 bool complex)
      : function_(std::move(function)),
        columns_(columns),
        pattern_(make_pattern(columns)),
        components_(components),
        complex_(complex) {}

  const substep::SparsePattern* pattern() const override { return pattern_.get(); }
  bool native() const override { return false; }
  std::int64_t evaluate(const ode::JacobianPoint& at, std::vector<double>& values) override {
    py::array y = complex_ ? py::array(py::array_t<std::complex<double>>(
                                 components_, reinterpret_cast<const std::complex<double>*>(at.y)))
                           : py::array(py::array_t<double>(components_, at.y));
    y.attr("flags").attr("writeable") = false;
    const auto result = function_(at.t, y).cast<std::pair<py::object, Values>>();
    if (!result.first.is(columns_)) {
      columns_ = result.first;
      pattern_ = make_pattern(columns_);
    }
    values = copy(result.second);
    return 0;
  }

 private:
  py::object function_, columns_;
  std::unique_ptr<const substep::SparsePattern> pattern_;
  std::int64_t components_;
  bool complex_;
};

// A compiled function of the user's: void(double t, double* y, double* J, double* p) that writes
// J[i * n + j] = df_i/dy_j, or the nonzeros of a pattern column by column.
class PointerJacobian final : public ode::Jacobian {
 public:
  using Function = void (*)(double t, double* y, double* J, double* p);

  PointerJacobian(Function function, std::int64_t size, double* parameters,
                  const py::object& columns)
      : function_(function),
        size_(static_cast<std::size_t>(size)),
        parameters_(parameters),
        pattern_(make_pattern(columns)) {}

  const substep::SparsePattern* pattern() const override { return pattern_.get(); }
  std::int64_t evaluate(const ode::JacobianPoint& at, std::vector<double>& values) override {
    double* y = const_cast<double*>(at.y);
    if (pattern_) {
      values.resize(pattern_->row.size());
      function_(at.t, y, values.data(), parameters_);
      return 0;
    }
    rows_.resize(size_ * size_);
    values.resize(size_ * size_);
    function_(at.t, y, rows_.data(), parameters_);
    for (std::size_t i = 0; i < size_; ++i) {
      for (std::size_t j = 0; j < size_; ++j) values[j * size_ + i] = rows_[i * size_ + j];
    }
    return 0;
  }

 private:
  Function function_;
  std::size_t size_;
  double* parameters_;
  std::unique_ptr<const substep::SparsePattern> pattern_;
  std::vector<double> rows_;
};

}  // namespace

void bind_jacobians(py::module_& m) {
  using ode::Jacobian;
  py::class_<Jacobian, std::shared_ptr<Jacobian>>(m, "Jacobian");
  py::class_<ConstantJacobian, Jacobian, std::shared_ptr<ConstantJacobian>>(m, "ConstantJacobian")
      .def(py::init<py::object, Values>(), py::arg("columns"), py::arg("values"));
  py::class_<PythonJacobian, Jacobian, std::shared_ptr<PythonJacobian>>(m, "PythonJacobian")
      .def(py::init<py::object, py::object, std::int64_t, bool>(), py::arg("function"),
           py::arg("columns"), py::arg("components"), py::arg("complex"));
  py::class_<PointerJacobian, Jacobian, std::shared_ptr<PointerJacobian>>(m, "PointerJacobian")
      .def(py::init([](std::uintptr_t address, std::int64_t size, py::array_t<double> parameters,
                       const py::object& columns) {
             return std::make_shared<PointerJacobian>(
                 reinterpret_cast<PointerJacobian::Function>(address), size,
                 const_cast<double*>(parameters.data()), columns);
           }),
           py::keep_alive<1, 4>(), py::arg("address"), py::arg("size"), py::arg("parameters"),
           py::arg("columns"));
  m.def(
      "finite_differences",
      [](const std::shared_ptr<ode::System>& system, const py::object& columns) {
        return ode::make_finite_differences(*system, make_pattern(columns));
      },
      py::keep_alive<0, 1>(), py::arg("system"), py::arg("columns"));
  m.def(
      "group_columns",
      [](const py::object& columns) {
        const std::vector<std::int32_t> group = ode::group_columns(*make_pattern(columns));
        return py::array_t<std::int32_t>(static_cast<py::ssize_t>(group.size()), group.data());
      },
      py::arg("columns"));
  py::class_<ode::MassMatrix, std::shared_ptr<ode::MassMatrix>>(m, "MassMatrix")
      .def(py::init([](const py::object& columns, const Values& values) {
             auto mass = std::make_shared<ode::MassMatrix>();
             mass->pattern = make_pattern(columns);
             mass->values = copy(values);
             return mass;
           }),
           py::arg("columns"), py::arg("values"));
}
