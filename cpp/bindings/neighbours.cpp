#include "arrays.h"
#include "substep/geometry/neighbour_search.h"

namespace {

using substep::geometry::make_neighbour_search;
using substep::geometry::NeighbourSearch;

std::unique_ptr<NeighbourSearch> make(const py::array& points) {
  return make_neighbour_search(readable(points), static_cast<int>(points.shape(1)));
}

py::tuple neighbour_lists(const py::array& points, double radius, bool half, int threads) {
  Array<std::int64_t> offsets(points.shape(0) + 1);
  std::int64_t* const first = offsets.mutable_data();
  const std::unique_ptr<NeighbourSearch> near = make(points);
  {
    const py::gil_scoped_release nogil;
    near->search(radius, threads);
    near->count_rows(half, first, threads);
  }
  Array<std::int32_t> indices(first[points.shape(0)]);
  std::int32_t* const out = indices.mutable_data();
  {
    const py::gil_scoped_release nogil;
    near->write_rows(half, first, out, threads);
  }
  return py::make_tuple(offsets, indices);
}

}  // namespace

void bind_neighbours(py::module_& m) {
  py::class_<NeighbourSearch>(m, "NeighbourSearch")
      .def(py::init(&make), py::arg("points"))
      .def("search", &NeighbourSearch::search, py::arg("radius"), py::arg("threads"),
           py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("bytes", &NeighbourSearch::bytes)
      .def_property_readonly("pair_count", &NeighbourSearch::pair_count);
  m.def("neighbour_lists", &neighbour_lists, py::arg("points"), py::arg("radius"), py::arg("half"),
        py::arg("threads"));
}
