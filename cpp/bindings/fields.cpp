#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/fields/any_flow.h"
#include "substep/fields/any_grid.h"

namespace {

using namespace substep::fields;

AnySeries series_of(const py::list& levels, std::vector<double> times) {
  AnySeries series;
  for (const py::handle level : levels) series.levels.push_back(level.cast<const AnyLevel*>());
  series.times = std::move(times);
  return series;
}

py::tuple as_tuple(const Event& event) { return py::make_tuple(event.step, event.particle); }

void bind_flow(py::module_& m) {
  py::class_<AnyFlow>(m, "Flow")
      .def(py::init([](const std::string& kind, int dimension, const std::vector<double>& p) {
             return make_flow(kind, dimension, p);
           }),
           py::arg("kind"), py::arg("dimension"), py::arg("parameters"))
      .def(
          "velocity",
          [](const AnyFlow& self, double t, const py::array& x, int threads) {
            py::array u = empty_like(x);
            const auto in = readable(x);
            const auto out = writable(u);
            const py::gil_scoped_release nogil;
            self.velocity(t, in, out, threads);
            return u;
          },
          py::arg("t"), py::arg("x"), py::arg("threads"))
      .def(
          "advect",
          [](const AnyFlow& self, const py::array& x, double origin, double h, std::int64_t first,
             std::int64_t count, const std::string& method, int threads) {
            py::array x_new = empty_like(x);
            const auto in = readable(x);
            const auto out = writable(x_new);
            const py::gil_scoped_release nogil;
            self.advect(method, in, out, {origin, h, first, count}, threads);
            return x_new;
          },
          py::arg("x"), py::arg("origin"), py::arg("h"), py::arg("first"), py::arg("count"),
          py::arg("method"), py::arg("threads"));
}

void bind_grid(py::module_& m) {
  py::class_<AnyLevel>(m, "GridLevel");
  py::class_<AnyGrid> grid(m, "Grid");
  grid.def(py::init([](const std::vector<std::vector<double>>& nodes,
                       const std::vector<double>& wrap, const std::vector<bool>& closed, bool cubic,
                       double radius, const std::string& dtype) {
             std::vector<Axis> axes;
             for (std::size_t d = 0; d < nodes.size(); ++d)
               axes.push_back({nodes[d], wrap[d], closed[d]});
             return make_grid(precision(dtype), axes, cubic, radius);
           }),
           py::arg("nodes"), py::arg("wrap"), py::arg("closed"), py::arg("cubic"),
           py::arg("radius"), py::arg("dtype"));
  // Corners (i, j) row by row.
  m.def(
      "curvilinear_grid",
      [](const Reals& x, const Reals& y, const std::vector<double>& z, bool on_faces, double radius,
         const std::string& dtype) {
        const Corners corners{x.shape(0), x.shape(1), list(x), list(y)};
        const auto staggering = on_faces ? Staggering::kFaces : Staggering::kCorners;
        const py::gil_scoped_release nogil;
        return make_curvilinear_grid(precision(dtype), corners, z, staggering, radius);
      },
      py::arg("x").noconvert(), py::arg("y").noconvert(), py::arg("z"), py::arg("on_faces"),
      py::arg("radius"), py::arg("dtype"));
  grid.def(
      "pack",
      [](const AnyGrid& self, const Reals& values, int threads) {
        const double* in = values.data();
        const py::gil_scoped_release nogil;
        return self.pack(in, threads);
      },
      py::arg("values").noconvert(), py::arg("threads"));
  grid.def_property_readonly("level_bytes", &AnyGrid::level_bytes);
  grid.def(
      "order",
      [](const AnyGrid& self, const py::array& x, int threads) {
        Array<std::int32_t> order(x.shape(0));
        const auto in = readable(x);
        std::int32_t* out = order.mutable_data();
        const py::gil_scoped_release nogil;
        self.order(in, out, threads);
        return order;
      },
      py::arg("x"), py::arg("threads"));
  grid.def(
      "velocity",
      [](const AnyGrid& self, const py::list& levels, const std::vector<double>& times, double t,
         const py::array& x, int threads) {
        py::array u = empty_like(x);
        const AnySeries series = series_of(levels, times);
        const auto in = readable(x);
        const auto out = writable(u);
        const py::gil_scoped_release nogil;
        self.velocity(series, t, in, out, threads);
        return u;
      },
      py::arg("levels"), py::arg("times"), py::arg("t"), py::arg("x"), py::arg("threads"));
  // Changes x, status and stop_time in place; returns the first landing, escape and failure.
  grid.def(
      "advect",
      [](const AnyGrid& self, const py::list& levels, const std::vector<double>& times,
         py::array& x, Array<std::int8_t>& status, Reals& stop_time, const py::object& order,
         double origin, double h, std::int64_t first, std::int64_t count, const std::string& method,
         int threads) {
        const AnySeries series = series_of(levels, times);
        Array<std::int32_t> sorted;
        if (!order.is_none()) sorted = order.cast<Array<std::int32_t>>();
        const AnyParticles particles{writable(x), writable(status), writable(stop_time),
                                     order.is_none() ? nullptr : sorted.data()};
        Events events;
        {
          const py::gil_scoped_release nogil;
          events = self.advect(method, series, particles, {origin, h, first, count}, threads);
        }
        return py::make_tuple(as_tuple(events.landed), as_tuple(events.escaped),
                              as_tuple(events.not_finite));
      },
      py::arg("levels"), py::arg("times"), py::arg("x"), py::arg("status").noconvert(),
      py::arg("stop_time").noconvert(), py::arg("order"), py::arg("origin"), py::arg("h"),
      py::arg("first"), py::arg("count"), py::arg("method"), py::arg("threads"));
}

}  // namespace

void bind_fields(py::module_& m) {
  // name -> (a, b, c, divisor of b).
  py::dict methods;
  for (const MethodTable& table : method_tables())
    methods[py::str(table.name)] = py::make_tuple(table.a, table.b, table.c, table.divisor);
  m.attr("advection_methods") = methods;
  bind_flow(m);
  bind_grid(m);
}
