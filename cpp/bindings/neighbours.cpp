#include "substep/geometry/neighbours.h"

#include "bindings.h"
#include "substep/core/parallel.h"
#include "substep/geometry/neighbour_rows.h"

namespace {

using namespace substep::geometry;
using substep::Point;

// Positions, and the same in cell order.
template <class Real>
class NeighbourSearch {
 public:
  using Rows = py::array_t<Real, py::array::c_style>;

  explicit NeighbourSearch(const Rows& points)
      : near_(static_cast<int>(points.shape(1))), x_(static_cast<std::size_t>(points.shape(0))) {
    sorted_.resize(x_.size());
    const Real* row = points.data();
    const py::ssize_t columns = points.shape(1);
    for (Point<Real>& p : x_) {
      p = {row[0], row[1], columns == 3 ? row[2] : Real{0}, Real{0}};
      row += columns;
    }
  }

  void search(Real radius, int threads) {
    near_.sort(x_, radius, threads);
    const std::int32_t* const order = near_.order().data();
    substep::parallel_for(
        near_.size(), 16384,
        [&](std::int64_t begin, std::int64_t end) {
          for (auto k = static_cast<std::size_t>(begin); k < static_cast<std::size_t>(end); ++k) {
            sorted_[k] = x_[static_cast<std::size_t>(order[k])];
          }
        },
        threads);
    near_.find(sorted_, radius, Pairs::kFull, threads);
  }

  const Neighbours<Real>& near() const { return near_; }

 private:
  Neighbours<Real> near_;
  std::vector<Point<Real>> x_, sorted_;
};

template <class Real>
py::tuple neighbour_lists(const typename NeighbourSearch<Real>::Rows& points, Real radius,
                          bool half, int threads) {
  const Pairs pairs = half ? Pairs::kHalf : Pairs::kFull;
  py::array_t<std::int64_t> offsets(points.shape(0) + 1);
  std::int64_t* const first = offsets.mutable_data();
  NeighbourSearch<Real> search(points);
  {
    const py::gil_scoped_release nogil;
    search.search(radius, threads);
    count_rows(search.near(), pairs, first, threads);
  }
  py::array_t<std::int32_t> indices(first[points.shape(0)]);
  std::int32_t* const out = indices.mutable_data();
  {
    const py::gil_scoped_release nogil;
    write_rows(search.near(), pairs, first, out, threads);
  }
  return py::make_tuple(offsets, indices);
}

template <class Real>
void bind(py::module_& m, const char* name) {
  using Search = NeighbourSearch<Real>;
  py::class_<Search>(m, name)
      .def(py::init<const typename Search::Rows&>(), py::arg("points").noconvert())
      .def("search", &Search::search, py::arg("radius"), py::arg("threads"),
           py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("bytes", [](const Search& self) { return self.near().bytes(); })
      .def_property_readonly("pair_count",
                             [](const Search& self) { return self.near().pair_count(); });
  m.def("neighbour_lists", &neighbour_lists<Real>, py::arg("points").noconvert(), py::arg("radius"),
        py::arg("half"), py::arg("threads"));
}

}  // namespace

void bind_neighbours(py::module_& m) {
  bind<float>(m, "NeighbourSearch");
  bind<double>(m, "NeighbourSearch64");
}
