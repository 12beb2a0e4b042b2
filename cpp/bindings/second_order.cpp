#include <pybind11/stl.h>

#include <cstring>
#include <memory>
#include <optional>

#include "arrays.h"
#include "substep/ode/solve/ensemble.h"
#include "substep/ode/symplectic/symplectic_solve.h"
#include "substep/ode/systems/chain.h"
#include "substep/ode/systems/nbody.h"
#include "substep/ode/systems/oscillators.h"
#include "substep/ode/systems/pointer_system.h"

namespace {

namespace ode = substep::ode;
using py::detail::array_proxy;
using py::detail::npy_api;

// x'' = a(t, x, v) as y' = f(t, y), for whoever asks.
class AccelerationSystem : public ode::System {
 public:
  explicit AccelerationSystem(std::int64_t components) : components_(components) {}
  std::int64_t size() const override { return 2 * components_; }
  bool second_order() const override { return true; }
  void rhs(double t, const double* y, double* dydt) override {
    std::copy_n(y + components_, components_, dydt);
    acceleration(t, y, y + components_, dydt + components_);
  }

 protected:
  std::int64_t components_;
};

// A read-only array that a Python function sees: the same one from call to call, unless the
// function kept it.
class LentArray {
 public:
  explicit LentArray(Sizes shape) : shape_(std::move(shape)) {}
  PyObject* lend(const double* values) {
    if (!array_ || Py_REFCNT(array_.ptr()) != 1) {
      py::array_t<double> fresh(shape_);
      bytes_ = static_cast<std::size_t>(fresh.nbytes());
      array_proxy(fresh.ptr())->flags &= ~npy_api::NPY_ARRAY_WRITEABLE_;
      array_ = std::move(fresh);
    }
    if (bytes_ > 0) std::memcpy(array_proxy(array_.ptr())->data, values, bytes_);
    return array_.ptr();
  }

 private:
  Sizes shape_;
  std::size_t bytes_ = 0;
  py::object array_;
};

// acceleration(t, x, v, *args) -> a, in the shape of x. What is not such an array of float64 goes
// to convert(value), which returns one or raises.
class PythonAcceleration final : public AccelerationSystem {
 public:
  PythonAcceleration(py::object fun, const Sizes& shape, const py::tuple& args, py::object convert)
      : AccelerationSystem(py::array_t<double>(shape).size()),
        fun_(std::move(fun)),
        convert_(std::move(convert)),
        args_(args),
        shape_(shape),
        x_(shape),
        v_(shape),
        call_(4, nullptr) {
    for (const py::handle arg : args_) call_.push_back(arg.ptr());
  }
  bool native() const override { return false; }

  void acceleration(double t, const double* x, const double* v, double* a) override {
    const py::float_ time(t);
    call_[1] = time.ptr();
    call_[2] = x_.lend(x);
    call_[3] = v_.lend(v);
    const auto value = py::reinterpret_steal<py::object>(
        PyObject_Vectorcall(fun_.ptr(), call_.data() + 1,
                            (call_.size() - 1) | PY_VECTORCALL_ARGUMENTS_OFFSET, nullptr));
    if (!value) throw py::error_already_set();
    if (copy(value.ptr(), a)) return;
    if (!copy(convert_(value).ptr(), a)) throw py::type_error("acceleration: not converted");
  }

 private:
  bool copy(PyObject* value, double* a) const {
    if (Py_TYPE(value) != npy_api::get().PyArray_Type_) return false;
    const auto* array = array_proxy(value);
    constexpr int kPlain = npy_api::NPY_ARRAY_C_CONTIGUOUS_ | npy_api::NPY_ARRAY_ALIGNED_;
    if (array->descr != dtype_.ptr() || (array->flags & kPlain) != kPlain ||
        array->nd != static_cast<int>(shape_.size()) ||
        !std::equal(shape_.begin(), shape_.end(), array->dimensions)) {
      return false;
    }
    if (components_ > 0) {
      std::memcpy(a, array->data, sizeof(double) * static_cast<std::size_t>(components_));
    }
    return true;
  }

  py::object fun_, convert_;
  py::tuple args_;
  py::dtype dtype_ = py::dtype::of<double>();
  Sizes shape_;
  LentArray x_, v_;
  std::vector<PyObject*> call_;  // a free slot, t, x, v, args...
};

// void(double t, const double* x, const double* v, double* a, double* p)
class PointerAcceleration final : public AccelerationSystem {
 public:
  using Function = void (*)(double, const double*, const double*, double*, double*);
  PointerAcceleration(std::uintptr_t address, std::int64_t components, double* parameters)
      : AccelerationSystem(components),
        function_(reinterpret_cast<Function>(address)),
        parameters_(parameters) {}
  void acceleration(double t, const double* x, const double* v, double* a) override {
    function_(t, x, v, a, parameters_);
  }

 private:
  Function function_;
  double* parameters_;
};

// Hands the numbers over to an array of that shape, without a copy.
Reals take(std::vector<double>&& values, const Sizes& shape) {
  auto owned = std::make_unique<std::vector<double>>(std::move(values));
  const double* data = owned->data();
  const py::capsule owner(owned.release(),
                          [](void* p) { delete static_cast<std::vector<double>*>(p); });
  return Reals(shape, data, owner);
}

py::dict solve(std::shared_ptr<ode::System> system, const std::string& method, double t0, double t1,
               const Reals& x0, const Reals& v0, double step, const std::optional<Reals>& t_eval,
               std::int64_t max_steps, int threads, const py::object& callback) {
  if (x0.size() != system->size() / 2 || v0.size() != x0.size()) {
    throw substep::InputError("x0: expected " + std::to_string(system->size() / 2) +
                              " components, as many as v0; got " + std::to_string(x0.size()));
  }
  const Sizes shape(x0.shape(), x0.shape() + x0.ndim());
  ode::SecondOrderProblem problem{
      .method = ode::symplectic_method(method),
      .t0 = t0,
      .t1 = t1,
      .step = step,
      .x0 = x0.data(),
      .v0 = v0.data(),
      .every_step = !t_eval,
      .t_eval = t_eval ? std::span(t_eval->data(), static_cast<std::size_t>(t_eval->size()))
                       : std::span<const double>(),
      .max_steps = max_steps,
      .threads = threads};
  if (!callback.is_none()) {
    problem.callback = [&](double t, const double* x, const double* v) {
      const py::gil_scoped_acquire gil;
      callback(t, Reals(shape, x), Reals(shape, v));
    };
  }
  ode::SecondOrderSolution solution;
  if (system->native()) {
    const py::gil_scoped_release release;
    solution = ode::solve_second_order(*system, problem);
  } else {
    solution = ode::solve_second_order(*system, problem);
  }
  Sizes rows = shape;
  rows.insert(rows.begin(), static_cast<py::ssize_t>(solution.t.size()));
  py::dict out;
  out["status"] = static_cast<int>(solution.status);
  out["steps"] = solution.steps;
  out["evaluations"] = solution.evaluations;
  out["time"] = solution.time;
  out["failure"] = solution.failure;
  out["failure_time"] = solution.failure_time;
  out["failure_component"] = solution.failure_component;
  out["t"] = take(std::move(solution.t), {rows[0]});
  out["x"] = take(std::move(solution.x), rows);
  out["v"] = take(std::move(solution.v), rows);
  return out;
}

// One right-hand side for all members, or one each; or a compiled function with one row of
// parameters per member.
py::tuple solve_ensemble(const std::vector<std::shared_ptr<ode::System>>& systems,
                         std::uintptr_t address, const Reals& parameters, const std::string& method,
                         double t0, double t1, const Reals& y0, double step,
                         std::vector<double> rtol, std::vector<double> atol, double first_step,
                         double max_step, bool local_extrapolation,
                         const std::vector<double>& t_eval, std::int64_t max_steps, int threads) {
  ode::Ensemble ensemble;
  ensemble.method = method;
  ensemble.t_eval = t_eval;
  ensemble.members = y0.shape(0);
  ensemble.size = y0.shape(1);
  ensemble.max_steps = max_steps;
  ensemble.threads = threads;
  ode::StepOptions& options = ensemble.options;
  options.t = t0;
  options.t_bound = t1;
  options.y = y0.data();
  options.step = step;
  options.rtol = std::move(rtol);
  options.atol = std::move(atol);
  options.first_step = first_step;
  options.max_step = max_step;
  options.local_extrapolation = local_extrapolation;
  auto* rows = const_cast<double*>(parameters.data());  // a single one where all share it
  const std::int64_t columns = parameters.ndim() == 2 ? parameters.shape(1) : 0;
  const auto system = [&](std::int64_t i) -> std::shared_ptr<ode::System> {
    if (address == 0) return systems[systems.size() == 1 ? 0 : static_cast<std::size_t>(i)];
    return std::make_shared<ode::PointerSystem>(
        reinterpret_cast<ode::PointerSystem::Function>(address), ensemble.size, rows + i * columns);
  };
  Sizes shape{y0.shape(0), y0.shape(1)};
  if (!t_eval.empty()) shape.push_back(static_cast<py::ssize_t>(t_eval.size()));
  Reals y(shape);
  std::fill_n(y.mutable_data(), y.size(), std::nan(""));
  std::vector<ode::Member> members;
  {
    double* out = y.mutable_data();
    const py::gil_scoped_release release;
    members = ode::solve_ensemble(ensemble, system, out);
  }
  py::list reports;
  for (const ode::Member& member : members) {
    reports.append(py::make_tuple(static_cast<int>(member.status), member.message, member.time,
                                  member.index, member.steps, member.evaluations));
  }
  return py::make_tuple(y, reports);
}

}  // namespace

void bind_second_order(py::module_& m) {
  using ode::System;
  py::class_<PythonAcceleration, System, std::shared_ptr<PythonAcceleration>>(m,
                                                                              "PythonAcceleration")
      .def(py::init<py::object, const Sizes&, const py::tuple&, py::object>(), py::arg("fun"),
           py::arg("shape"), py::arg("args"), py::arg("convert"));
  py::class_<PointerAcceleration, System, std::shared_ptr<PointerAcceleration>>(
      m, "PointerAcceleration")
      .def(py::init([](std::uintptr_t address, std::int64_t components, const Reals& parameters) {
             return std::make_shared<PointerAcceleration>(address, components,
                                                          const_cast<double*>(parameters.data()));
           }),
           py::keep_alive<1, 4>(), py::arg("address"), py::arg("components"),
           py::arg("parameters"));
  m.def(
      "oscillators",
      [](const Reals& omega) -> std::shared_ptr<System> {
        return std::make_shared<ode::Oscillators>(list(omega));
      },
      py::arg("omega"));
  m.def(
      "spring_chain",
      [](std::int64_t n, const Reals& k, const Reals& masses,
         bool fixed_ends) -> std::shared_ptr<System> {
        return std::make_shared<ode::SpringChain>(n, list(k), list(masses), fixed_ends);
      },
      py::arg("n"), py::arg("k"), py::arg("m"), py::arg("fixed_ends"));
  m.def(
      "n_body",
      [](const Reals& masses, double G, double softening,
         int dimension) -> std::shared_ptr<System> {
        return std::make_shared<ode::NBody>(list(masses), G, softening, dimension);
      },
      py::arg("masses"), py::arg("G"), py::arg("softening"), py::arg("dimension"));

  m.def("second_order_methods", [] {
    py::list methods;
    for (const ode::SymplecticMethod& method : ode::kSymplecticMethods) {
      py::dict entry;
      entry["name"] = std::string(method.name);
      entry["order"] = method.order;
      entry["evaluations"] = method.evaluations;
      entry["symmetric"] = method.symmetric;
      methods.append(entry);
    }
    return methods;
  });
  m.def("solve_second_order", &solve, py::kw_only(), py::arg("system"), py::arg("method"),
        py::arg("t0"), py::arg("t1"), py::arg("x0"), py::arg("v0"), py::arg("step"),
        py::arg("t_eval"), py::arg("max_steps"), py::arg("threads"), py::arg("callback"));
  m.def("solve_ensemble", &solve_ensemble, py::kw_only(), py::arg("systems"), py::arg("address"),
        py::arg("parameters"), py::arg("method"), py::arg("t0"), py::arg("t1"), py::arg("y0"),
        py::arg("step"), py::arg("rtol"), py::arg("atol"), py::arg("first_step"),
        py::arg("max_step"), py::arg("local_extrapolation"), py::arg("t_eval"),
        py::arg("max_steps"), py::arg("threads"));
}
