// Groups of constraints, also of functions of the user.
#include <pybind11/stl.h>

#include <algorithm>

#include "arrays.h"
#include "owner.h"
#include "substep/pbd/solver/recipes.h"

namespace {

using namespace substep::pbd;

using Ids = Array<std::int64_t>;

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
    const InUserFunction function;
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

template <std::size_t Columns, class T>
std::vector<std::array<T, Columns>> rows_of(const Array<T>& a) {
  std::vector<std::array<T, Columns>> rows(static_cast<std::size_t>(a.size()) / Columns);
  for (std::size_t i = 0; i < rows.size(); ++i)
    std::copy_n(a.data() + Columns * i, Columns, rows[i].begin());
  return rows;
}

std::unique_ptr<Recipe> of_user(const py::object& fun, const py::object& address,
                                const Reals& parameters, const Indices& particles,
                                const Reals& origin, const Reals& compliance, const Reals& damping,
                                const Reals& stiffness, bool inequality) {
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
  return user_recipe(std::move(k));
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
  py::class_<Recipe>(m, "ConstraintGroup")
      .def(py::init([](const std::string& kind, const Indices& particles, const Reals& parameters,
                       const Reals& compliance, const Reals& damping, const Reals& stiffness) {
             return constraint_recipe(kind, list(particles), list(parameters), list(compliance),
                                      list(damping), list(stiffness));
           }),
           py::arg("kind"), py::arg("particles").noconvert(), py::arg("parameters").noconvert(),
           py::arg("compliance").noconvert(), py::arg("damping").noconvert(),
           py::arg("stiffness").noconvert());
  m.def(
      "shape_matching",
      [](const Ids& start, const Indices& particles, const Reals& rest, const Reals& compliance,
         const Reals& damping, const Reals& stiffness, double linear) {
        return shape_matching_recipe({.start = list(start),
                                      .particle = list(particles),
                                      .rest = rows_of<3>(rest),
                                      .compliance = list(compliance),
                                      .damping = list(damping),
                                      .stiffness = list(stiffness),
                                      .linear = linear});
      },
      py::arg("start").noconvert(), py::arg("particles").noconvert(), py::arg("rest").noconvert(),
      py::arg("compliance").noconvert(), py::arg("damping").noconvert(),
      py::arg("stiffness").noconvert(), py::arg("linear"));
  m.def("user_constraints", &of_user, py::arg("fun"), py::arg("address"),
        py::arg("parameters").noconvert(), py::arg("particles").noconvert(),
        py::arg("origin").noconvert(), py::arg("compliance").noconvert(),
        py::arg("damping").noconvert(), py::arg("stiffness").noconvert(), py::arg("inequality"));
  m.def(
      "self_collision",
      [](const Indices& faces, const Reals& rest, double thickness, double friction) {
        return self_contact_recipe(rows_of<3>(faces), Points(rest).copied(), thickness, friction);
      },
      py::arg("faces").noconvert(), py::arg("rest").noconvert(), py::arg("thickness"),
      py::arg("friction"));
  m.def(
      "particle_collision",
      [](const Reals& radii, const Reals& rest, double friction) {
        return particle_collision_recipe(list(radii), list(rest), friction);
      },
      py::arg("radii").noconvert(), py::arg("rest").noconvert(), py::arg("friction"));
}
