#include "substep/core/batch.h"

#include <pybind11/stl.h>

#include <algorithm>
#include <limits>
#include <memory>

#include "arrays.h"

namespace {

std::span<const double> of_each(const substep::SimulationBatch& batch, const Reals& values) {
  if (values.size() != batch.size()) throw py::value_error("expected one number for each world");
  return readable(values);
}

// Rows of all particles of all worlds, NaN where a world has fewer.
Reals gather(const substep::SimulationBatch& batch,
             std::vector<double> (substep::Simulation::*get)() const) {
  const std::int64_t worlds = batch.size();
  std::vector<std::vector<double>> rows;
  std::size_t most = 0;
  {
    const py::gil_scoped_release released;
    for (std::int64_t w = 0; w < worlds; ++w) {
      rows.push_back((batch.world(w).*get)());
      most = std::max(most, rows.back().size());
    }
  }
  const auto columns = py::ssize_t{batch.world(0).columns()};
  Reals all = made(Reals({py::ssize_t{worlds}, static_cast<py::ssize_t>(most) / columns, columns}));
  double* out = all.mutable_data();
  std::fill_n(out, all.size(), std::numeric_limits<double>::quiet_NaN());
  for (const std::vector<double>& row : rows) {
    std::copy(row.begin(), row.end(), out);
    out += most;
  }
  return all;
}

}  // namespace

void bind_batch(py::module_& m) {
  py::class_<substep::Simulation>(m, "Simulation");
  py::class_<substep::SimulationBatch>(m, "Batch")
      .def(py::init([](const std::vector<substep::Simulation*>& worlds) {
             return new substep::SimulationBatch(worlds);
           }),
           py::arg("worlds"), py::keep_alive<1, 2>())
      .def_readwrite("threads", &substep::SimulationBatch::threads)
      .def_readwrite("mask", &substep::SimulationBatch::mask)
      .def_property_readonly("time", &substep::SimulationBatch::time)
      .def_property_readonly("times",
                             [](const substep::SimulationBatch& self) {
                               Reals times = made(Reals(self.size()));
                               for (std::int64_t w = 0; w < self.size(); ++w)
                                 times.mutable_at(w) = self.world(w).time();
                               return times;
                             })
      .def_property(
          "failures",
          [](const substep::SimulationBatch& self) {
            std::vector<std::string> failures;
            for (std::int64_t w = 0; w < self.size(); ++w) failures.push_back(self.failure(w));
            return failures;
          },
          [](substep::SimulationBatch& self, const std::vector<std::string>& failures) {
            for (std::int64_t w = 0; w < self.size(); ++w)
              self.set_failure(w, failures[static_cast<std::size_t>(w)]);
          })
      .def("positions",
           [](const substep::SimulationBatch& self) {
             return gather(self, &substep::Simulation::positions);
           })
      .def("velocities",
           [](const substep::SimulationBatch& self) {
             return gather(self, &substep::Simulation::velocities);
           })
      .def(
          "step",
          [](substep::SimulationBatch& self, const Reals& sizes, const Reals& times,
             std::int64_t count) {
            const auto h = of_each(self, sizes), t = of_each(self, times);
            const py::gil_scoped_release released;
            self.step(h, t, count);
          },
          py::arg("sizes").noconvert(), py::arg("times").noconvert(), py::arg("count"))
      .def(
          "advance",
          [](substep::SimulationBatch& self, const Reals& ends) {
            const auto t = of_each(self, ends);
            const py::gil_scoped_release released;
            self.advance(t);
          },
          py::arg("ends").noconvert())
      .def(
          "advance_once",
          [](substep::SimulationBatch& self, const Reals& ends, bool first) {
            const auto t = of_each(self, ends);
            const py::gil_scoped_release released;
            self.advance_once(t, first);
          },
          py::arg("ends").noconvert(), py::arg("first"));
}
