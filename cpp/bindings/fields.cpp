#include <pybind11/stl.h>

#include "bindings.h"
#include "substep/fields/flow_advection.h"
#include "substep/fields/grid_advection.h"

namespace {

using namespace substep::fields;
namespace tableaux = substep::tableaux;

template <class T>
using Rows = py::array_t<T, py::array::c_style>;

// flow.velocity(t, x) and flow.advect(x, origin, h, first, count, method, threads), for one dtype.
template <class T, class Flow>
void define(py::class_<Flow>& flow) {
  flow.def(
      "velocity",
      [](const Flow& self, double t, const Rows<T>& x, int threads) {
        Rows<T> u({x.shape(0), x.shape(1)});
        const T* in = x.data();
        T* out = u.mutable_data();
        const auto count = x.shape(0);
        const py::gil_scoped_release nogil;
        sample_flow(self, t, in, out, count, threads);
        return u;
      },
      py::arg("t"), py::arg("x").noconvert(), py::arg("threads"));
  flow.def(
      "advect",
      [](const Flow& self, const Rows<T>& x, double origin, double h, std::int64_t first,
         std::int64_t count, const std::string& method, int threads) {
        Rows<T> x_new({x.shape(0), x.shape(1)});
        const T* in = x.data();
        T* out = x_new.mutable_data();
        const auto particles = x.shape(0);
        const py::gil_scoped_release nogil;
        advect_flow(self, method, in, out, particles, {origin, h, first, count}, threads);
        return x_new;
      },
      py::arg("x").noconvert(), py::arg("origin"), py::arg("h"), py::arg("first"), py::arg("count"),
      py::arg("method"), py::arg("threads"));
}

template <class Flow, class Make, class... Names>
void bind_flow(py::module_& m, const char* name, Make make, Names... names) {
  py::class_<Flow> flow(m, name);
  flow.def(py::init(make), py::arg(names)...);
  define<double>(flow);
  define<float>(flow);
}

using Vector3 = std::array<double, 3>;

template <class T>
Series<T> make_series(const py::list& levels, const std::vector<double>& times) {
  Series<T> series;
  for (const py::handle level : levels) series.levels.push_back(level.cast<const Level<T>*>());
  series.times = times;
  return series;
}

py::tuple as_tuple(const Event& event) { return py::make_tuple(event.step, event.particle); }

template <class T, int kDim>
void bind_grid(py::module_& m, const std::string& name) {
  using G = Grid<T, kDim>;
  py::class_<G> grid(m, name.c_str());
  grid.def(
      py::init([](const std::vector<std::vector<double>>& nodes, const std::vector<double>& wrap,
                  const std::vector<bool>& closed, bool cubic, double radius) {
        std::vector<Axis> axes;
        for (std::size_t d = 0; d < nodes.size(); ++d)
          axes.push_back({nodes[d], wrap[d], closed[d]});
        return G(axes, cubic, radius);
      }),
      py::arg("nodes"), py::arg("wrap"), py::arg("closed"), py::arg("cubic"), py::arg("radius"));
  grid.def(
      "pack",
      [](const G& self, const Rows<double>& values, int threads) {
        const double* in = values.data();
        const py::gil_scoped_release nogil;
        return std::make_unique<Level<T>>(self.pack(in, threads));
      },
      py::arg("values").noconvert(), py::arg("threads"));
  grid.def_property_readonly("level_bytes", [](const G& self) {
    return self.node_count() * static_cast<std::int64_t>(sizeof(Node<T>));
  });
  grid.def(
      "order",
      [](const G& self, const Rows<T>& x, int threads) {
        py::array_t<std::int32_t> order(x.shape(0));
        const T* in = x.data();
        std::int32_t* out = order.mutable_data();
        const auto count = x.shape(0);
        const py::gil_scoped_release nogil;
        sort_by_cell(self, in, count, out, threads);
        return order;
      },
      py::arg("x").noconvert(), py::arg("threads"));
  grid.def(
      "velocity",
      [](const G& self, const py::list& levels, const std::vector<double>& times, double t,
         const Rows<T>& x, int threads) {
        Rows<T> u({x.shape(0), x.shape(1)});
        const Series<T> series = make_series<T>(levels, times);
        const T* in = x.data();
        T* out = u.mutable_data();
        const auto count = x.shape(0);
        const py::gil_scoped_release nogil;
        sample_grid(self, series.at(t), in, out, count, threads);
        return u;
      },
      py::arg("levels"), py::arg("times"), py::arg("t"), py::arg("x").noconvert(),
      py::arg("threads"));
  // Changes x, status and stop_time in place; returns the first landing, escape and failure.
  grid.def(
      "advect",
      [](const G& self, const py::list& levels, const std::vector<double>& times, Rows<T>& x,
         Rows<std::int8_t>& status, Rows<double>& stop_time,
         const std::optional<Rows<std::int32_t>>& order, double origin, double h,
         std::int64_t first, std::int64_t count, const std::string& method, int threads) {
        const Series<T> series = make_series<T>(levels, times);
        const Particles<T> particles{x.mutable_data(), status.mutable_data(),
                                     stop_time.mutable_data(), order ? order->data() : nullptr,
                                     x.shape(0)};
        Events events;
        {
          const py::gil_scoped_release nogil;
          events = advect_grid(self, method, series, particles, {origin, h, first, count}, threads);
        }
        return py::make_tuple(as_tuple(events.landed), as_tuple(events.escaped),
                              as_tuple(events.not_finite));
      },
      py::arg("levels"), py::arg("times"), py::arg("x").noconvert(), py::arg("status").noconvert(),
      py::arg("stop_time").noconvert(), py::arg("order"), py::arg("origin"), py::arg("h"),
      py::arg("first"), py::arg("count"), py::arg("method"), py::arg("threads"));
}

}  // namespace

static void bind_flows(py::module_& m) {
  bind_flow<RigidRotation<2>>(
      m, "RigidRotation2",
      [](Vector3 omega, Vector3 center) { return RigidRotation<2>{omega, center}; }, "omega",
      "center");
  bind_flow<RigidRotation<3>>(
      m, "RigidRotation3",
      [](Vector3 omega, Vector3 center) { return RigidRotation<3>{omega, center}; }, "omega",
      "center");
  bind_flow<Shear<2>>(
      m, "Shear2",
      [](double rate, int flow, int gradient) { return Shear<2>{rate, flow, gradient}; }, "rate",
      "flow", "gradient");
  bind_flow<Shear<3>>(
      m, "Shear3",
      [](double rate, int flow, int gradient) { return Shear<3>{rate, flow, gradient}; }, "rate",
      "flow", "gradient");
  bind_flow<TaylorGreen>(
      m, "TaylorGreen", [](double u, double k, double nu) { return TaylorGreen{u, k, nu}; }, "u",
      "k", "nu");
  bind_flow<Abc>(
      m, "Abc", [](double a, double b, double c) { return Abc{a, b, c}; }, "a", "b", "c");
  bind_flow<DoubleGyre>(
      m, "DoubleGyre",
      [](double a, double epsilon, double omega) { return DoubleGyre{a, epsilon, omega}; }, "a",
      "epsilon", "omega");
}

void bind_fields(py::module_& m) {
  // The tables of the methods, for callables of the user: name -> (a, b, c, divisor of b).
  py::dict methods;
  tableaux::for_each_method<tableaux::FixedMethods>([&]<class Method>(const Method&) {
    using Weights = tableaux::WholeWeights<Method>;
    py::list a, b, c;
    for (int i = 0; i < Method::stages; ++i) {
      py::list row;
      for (int j = 0; j < i; ++j) row.append(Method::a[i][j]);
      a.append(row);
      b.append(Weights::b[static_cast<std::size_t>(i)]);
      c.append(Method::c[i]);
    }
    methods[py::str(Method::name)] = py::make_tuple(a, b, c, double(Weights::divisor));
  });
  m.attr("advection_methods") = methods;
  bind_flows(m);
  py::class_<Level<double>>(m, "GridLevel64");
  py::class_<Level<float>>(m, "GridLevel32");
  bind_grid<double, 2>(m, "Grid2_64");
  bind_grid<double, 3>(m, "Grid3_64");
  bind_grid<float, 2>(m, "Grid2_32");
  bind_grid<float, 3>(m, "Grid3_32");
}
