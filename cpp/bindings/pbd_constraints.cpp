// Groups of constraints that are no formulas: clusters, and functions of the user.
#include <pybind11/stl.h>

#include <algorithm>

#include "bindings.h"
#include "pbd_groups.h"
#include "substep/core/errors.h"
#include "substep/pbd/groups/shape_matching.h"
#include "substep/pbd/groups/user_constraints.h"

namespace {

using namespace substep::pbd;

using Reals = py::array_t<double, py::array::c_style>;
using Ids = py::array_t<std::int64_t, py::array::c_style>;
using Indices = py::array_t<std::int32_t, py::array::c_style>;

template <class T>
std::vector<T> list(const py::array_t<T, py::array::c_style>& a) {
  return {a.data(), a.data() + a.size()};
}

// fun(x) -> (C, gradient), float64 and C-contiguous, as the Python layer has checked.
class PythonFunction final : public UserFunction {
 public:
  PythonFunction(py::function fun, int points) : fun_(std::move(fun)), points_(points) {}
  PythonFunction(const PythonFunction&) = delete;
  PythonFunction& operator=(const PythonFunction&) = delete;
  ~PythonFunction() override {
    const py::gil_scoped_acquire gil;
    fun_ = py::function();
  }

  void evaluate(std::int64_t /*first*/, std::int64_t count, const double* x, double* c,
                double* gradient) override {
    const py::gil_scoped_acquire gil;
    Reals positions(
        {static_cast<py::ssize_t>(count), static_cast<py::ssize_t>(points_), py::ssize_t{3}}, x);
    const auto result = fun_(positions).cast<std::pair<Reals, Reals>>();
    std::copy_n(result.first.data(), result.first.size(), c);
    std::copy_n(result.second.data(), result.second.size(), gradient);
  }

 private:
  py::function fun_;
  int points_;
};

// void fun(const double* x, double* c, double* gradient, double* p), one constraint at a time; p
// are the parameters of that constraint.
class CompiledFunction final : public UserFunction {
 public:
  using Function = void (*)(const double*, double*, double*, double*);
  CompiledFunction(std::uintptr_t address, const Reals& parameters, py::object owner)
      : function_(reinterpret_cast<Function>(address)),
        parameters_(list(parameters)),
        width_(parameters.shape(1)),
        owner_(std::move(owner)) {}
  CompiledFunction(const CompiledFunction&) = delete;
  CompiledFunction& operator=(const CompiledFunction&) = delete;
  ~CompiledFunction() override {
    const py::gil_scoped_acquire gil;
    owner_ = py::object();
  }

  void evaluate(std::int64_t first, std::int64_t /*count*/, const double* x, double* c,
                double* gradient) override {
    function_(x, c, gradient, parameters_.data() + first * width_);
  }

 private:
  Function function_;
  std::vector<double> parameters_;
  std::int64_t width_;
  py::object owner_;
};

template <class Real>
void bind_groups(py::module_& m, const std::string& bits) {
  m.def(("shape_matching" + bits).c_str(),
        [](const Ids& start, const Indices& particles, const Reals& rest, const Reals& compliance,
           const Reals& damping, const Reals& stiffness, double linear) {
          Clusters k{.start = list(start),
                     .particle = list(particles),
                     .rest = {},
                     .compliance = list(compliance),
                     .damping = list(damping),
                     .stiffness = list(stiffness),
                     .linear = linear};
          for (py::ssize_t i = 0; i < rest.shape(0); ++i) {
            k.rest.push_back({rest.at(i, 0), rest.at(i, 1), rest.at(i, 2)});
          }
          return GroupHandle<Real>{std::make_unique<ShapeMatching<Real>>(std::move(k))};
        },
        py::arg("start").noconvert(), py::arg("particles").noconvert(), py::arg("rest").noconvert(),
        py::arg("compliance").noconvert(), py::arg("damping").noconvert(),
        py::arg("stiffness").noconvert(), py::arg("linear"));
  m.def(("user_constraints" + bits).c_str(),
        [](const py::object& fun, const py::object& address, const Reals& parameters,
           const Indices& particles, const Reals& origin, const Reals& compliance,
           const Reals& damping, const Reals& stiffness, bool inequality) {
          UserConstraints k{.function = nullptr,
                            .points = static_cast<int>(particles.shape(1)),
                            .batch = address.is_none() ? particles.shape(0) : 1,
                            .particles = list(particles),
                            .origin = {origin.at(0), origin.at(1), origin.at(2)},
                            .compliance = list(compliance),
                            .damping = list(damping),
                            .stiffness = list(stiffness),
                            .inequality = inequality};
          if (address.is_none()) {
            k.function = std::make_shared<PythonFunction>(fun.cast<py::function>(), k.points);
          } else {
            k.function =
                std::make_shared<CompiledFunction>(address.cast<std::uintptr_t>(), parameters, fun);
          }
          return GroupHandle<Real>{std::make_unique<UserGroup<Real>>(std::move(k))};
        },
        py::arg("fun"), py::arg("address"), py::arg("parameters").noconvert(),
        py::arg("particles").noconvert(), py::arg("origin").noconvert(),
        py::arg("compliance").noconvert(), py::arg("damping").noconvert(),
        py::arg("stiffness").noconvert(), py::arg("inequality"));
}

}  // namespace

void bind_pbd_constraints(py::module_& m) {
  m.def(
      "call_constraint",
      [](std::uintptr_t address, const Reals& parameters, const Reals& x) {
        CompiledFunction fun(address, parameters, py::none());
        Reals c(x.shape(0)), gradient({x.shape(0), x.shape(1), py::ssize_t{3}});
        std::fill_n(gradient.mutable_data(), gradient.size(), 0.0);
        const py::ssize_t width = 3 * x.shape(1);
        for (py::ssize_t j = 0; j < x.shape(0); ++j) {
          fun.evaluate(j, 1, x.data() + width * j, c.mutable_data() + j,
                       gradient.mutable_data() + width * j);
        }
        return std::pair(c, gradient);
      },
      py::arg("address"), py::arg("parameters").noconvert(), py::arg("x").noconvert());
  bind_groups<float>(m, "32");
  bind_groups<double>(m, "64");
}
