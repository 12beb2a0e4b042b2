#include <pybind11/stl.h>

#include <algorithm>

#include "arrays.h"
#include "substep/rigid/motion/free_rotation.h"
#include "substep/rigid/shapes/mass_properties.h"

namespace {

using namespace substep;
using namespace substep::rigid;

using Array4 = std::array<double, 4>;  // (w, x, y, z)
using Array9 = std::array<double, 9>;  // row by row

std::vector<Vec3> rows_of(const Reals& points) {
  std::vector<Vec3> rows;
  for (py::ssize_t i = 0; i < points.shape(0); ++i) rows.emplace_back(points.data(i, 0));
  return rows;
}

void bind_free_rotation(py::module_& m) {
  m.def(
      "rotate_freely",
      [](const std::string& name, const Reals& q, const Reals& L, const Reals& inertia, double dt,
         std::int64_t steps, int threads) {
        const char* const names[] = {"exact", "splitting", "quaternion", "matrix"};
        const auto method = static_cast<FreeRotation>(
            std::find(std::begin(names), std::end(names), name) - std::begin(names));
        Reals turned({q.shape(0), q.shape(1)});
        const auto n = q.shape(0);
        const double *from = q.data(), *momenta = L.data(), *moments = inertia.data();
        double* out = turned.mutable_data();
        const py::gil_scoped_release nogil;
        std::copy(from, from + 4 * n, out);
        rotate_freely(method, n, out, momenta, moments, dt, steps, threads);
        return turned;
      },
      py::arg("method"), py::arg("rotations"), py::arg("angular_momenta"), py::arg("inertia"),
      py::arg("dt"), py::arg("steps"), py::arg("threads"));
}

void bind_mass_moments(py::module_& m) {
  py::class_<MassMoments>(m, "MassMoments")
      .def(py::init([](double mass, const Triple& centre, const Array9& inertia) {
             return MassMoments{mass, vector(centre), Mat3(inertia.data()).transpose()};
           }),
           py::arg("mass"), py::arg("centre"), py::arg("inertia"))
      .def_readonly("mass", &MassMoments::mass)
      .def_property_readonly("centre", [](const MassMoments& self) { return triple(self.centre); })
      .def_property_readonly("inertia",
                             [](const MassMoments& self) {
                               Array9 rows;
                               Mat3::Map(rows.data()) = self.inertia.transpose();
                               return rows;
                             })
      .def(
          "moved",
          [](const MassMoments& self, const Triple& position, const Array4& q) {
            return moved(self, {vector(position), load_quaternion(q.data())});
          },
          py::arg("position"), py::arg("rotation"))
      .def("principal", [](const MassMoments& self) {
        const MassProperties p = principal(self);
        Array4 axes;
        store_quaternion(p.axes, axes.data());
        return py::make_tuple(axes, triple(p.inertia));
      });
  m.def(
      "mesh_moments",
      [](const Reals& vertices, const LongIndices& faces, double density) {
        const std::span<const double> x(vertices.data(), static_cast<std::size_t>(vertices.size()));
        const std::span<const std::int64_t> f(faces.data(), static_cast<std::size_t>(faces.size()));
        const py::gil_scoped_release nogil;
        return moments(x, f, density);
      },
      py::arg("vertices"), py::arg("faces"), py::arg("density"));
  m.def(
      "hull_faces",
      [](const Reals& points) {
        const ConvexHull hull(rows_of(points));
        Reals vertices({py::ssize_t{hull.vertex_count()}, py::ssize_t{3}});
        for (int i = 0; i < hull.vertex_count(); ++i)
          Vec3::Map(vertices.mutable_data(i, 0)) = hull.vertices()[i];
        std::vector<std::array<std::int64_t, 3>> faces;  // fans of the flat faces
        for (int f = 0; f < hull.face_count(); ++f) {
          const auto corners = hull.corners(f);
          for (std::size_t k = 2; k < corners.size(); ++k)
            faces.push_back({corners[0], corners[k - 1], corners[k]});
        }
        return py::make_tuple(vertices, faces);
      },
      py::arg("points"));
  m.def(
      "sum_moments", [](const std::vector<MassMoments>& parts) { return sum(parts); },
      py::arg("parts"));
}

}  // namespace

void bind_rigid(py::module_& m) {
  bind_free_rotation(m);
  bind_mass_moments(m);
}
