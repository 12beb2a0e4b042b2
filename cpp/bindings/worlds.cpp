#include <pybind11/stl.h>

#include <algorithm>
#include <limits>
#include <memory>

#include "arrays.h"
#include "substep/core/batch.h"

namespace {

using substep::Batch;
using substep::Simulation;

std::span<const double> each(const Batch& batch, const Reals& values) {
  if (values.size() != batch.size()) throw py::value_error("expected one number for each world");
  return readable(values);
}

// Rows of all particles of all worlds, NaN where a world has fewer.
Reals gather(const Batch& batch, std::vector<double> (Simulation::*get)() const) {
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
  py::class_<Simulation>(m, "Simulation");
  py::class_<Batch>(m, "Batch")
      .def(py::init([](const std::vector<Simulation*>& worlds) { return new Batch(worlds); }),
           py::arg("worlds"), py::keep_alive<1, 2>())
      .def_readwrite("threads", &Batch::threads)
      .def_readwrite("mask", &Batch::mask)
      .def_property_readonly("time", &Batch::time)
      .def_property_readonly("times",
                             [](const Batch& self) {
                               Reals times = made(Reals(self.size()));
                               for (std::int64_t w = 0; w < self.size(); ++w)
                                 times.mutable_at(w) = self.world(w).time();
                               return times;
                             })
      .def_property(
          "failures",
          [](const Batch& self) {
            std::vector<std::string> failures;
            for (std::int64_t w = 0; w < self.size(); ++w) failures.push_back(self.failure(w));
            return failures;
          },
          [](Batch& self, const std::vector<std::string>& failures) {
            for (std::int64_t w = 0; w < self.size(); ++w)
              self.set_failure(w, failures[static_cast<std::size_t>(w)]);
          })
      .def("positions", [](const Batch& self) { return gather(self, &Simulation::positions); })
      .def("velocities", [](const Batch& self) { return gather(self, &Simulation::velocities); })
      .def(
          "step",
          [](Batch& self, const Reals& sizes, const Reals& times, std::int64_t count) {
            const auto h = each(self, sizes), t = each(self, times);
            const py::gil_scoped_release released;
            self.step(h, t, count);
          },
          py::arg("sizes").noconvert(), py::arg("times").noconvert(), py::arg("count"))
      .def(
          "advance",
          [](Batch& self, const Reals& ends) {
            const auto t = each(self, ends);
            const py::gil_scoped_release released;
            self.advance(t);
          },
          py::arg("ends").noconvert())
      .def(
          "advance_once",
          [](Batch& self, const Reals& ends, bool first) {
            const auto t = each(self, ends);
            const py::gil_scoped_release released;
            self.advance_once(t, first);
          },
          py::arg("ends").noconvert(), py::arg("first"));
}
