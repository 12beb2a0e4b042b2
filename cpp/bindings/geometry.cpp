#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/geometry/collider.h"
#include "substep/geometry/each_point.h"
#include "substep/geometry/isosurface_stuffing.h"
#include "substep/geometry/largest_speed.h"
#include "substep/geometry/mesh_sampling.h"
#include "substep/geometry/poisson_disk.h"

namespace {

using namespace substep::geometry;

using Rows = Reals;

// evaluate(point, row of out) for each row of points; out has `columns` numbers a row.
Rows for_points(const Rows& points, Sizes columns, int threads, const EachPoint& evaluate) {
  columns.insert(columns.begin(), points.shape(0));
  Rows result(columns);
  const auto in = readable(points);
  const auto out = writable(result);
  const py::gil_scoped_release nogil;
  for_each_point(in, out, evaluate, threads);
  return result;
}

void bind_sampled_distance(py::module_& m) {
  py::class_<SampledDistance, std::shared_ptr<SampledDistance>>(m, "SampledDistance")
      .def(py::init([](const Rows& values, const Triple& origin, double spacing, int threads) {
             std::vector<double> copy(values.data(), values.data() + values.size());
             const std::array<std::int64_t, 3> shape{values.shape(0), values.shape(1),
                                                     values.shape(2)};
             const py::gil_scoped_release nogil;
             return std::make_shared<SampledDistance>(shape, vector(origin), spacing,
                                                      std::move(copy), threads);
           }),
           py::arg("values").noconvert(), py::arg("origin"), py::arg("spacing"), py::arg("threads"))
      .def_property_readonly("values",
                             [](const SampledDistance& self) {
                               const auto& [nx, ny, nz] = self.shape();
                               return Rows({nx, ny, nz}, self.values().data());
                             })
      .def(py::pickle(
          [](const SampledDistance& self) {
            const auto& [nx, ny, nz] = self.shape();
            return py::make_tuple(Rows({nx, ny, nz}, self.values().data()), triple(self.origin()),
                                  self.spacing());
          },
          [](const py::tuple& state) {
            const auto values = state[0].cast<Rows>();
            return std::make_shared<SampledDistance>(
                std::array<std::int64_t, 3>{values.shape(0), values.shape(1), values.shape(2)},
                vector(state[1].cast<Triple>()), state[2].cast<double>(),
                std::vector<double>(values.data(), values.data() + values.size()));
          }))
      .def_property_readonly("origin",
                             [](const SampledDistance& self) { return triple(self.origin()); })
      .def_property_readonly("spacing", &SampledDistance::spacing)
      .def_property_readonly("error_bound", &SampledDistance::error_bound);
}

void bind_height_field(py::module_& m) {
  const auto make = [](const Rows& heights, const Triple& origin, double spacing) {
    std::vector<double> copy(heights.data(), heights.data() + heights.size());
    const std::array<std::int64_t, 2> shape{heights.shape(0), heights.shape(1)};
    const py::gil_scoped_release nogil;
    return std::make_shared<HeightField>(shape, vector(origin), spacing, std::move(copy));
  };
  const auto heights = [](const HeightField& self) {
    return Rows({self.shape()[0], self.shape()[1]}, self.heights().data());
  };
  py::class_<HeightField, std::shared_ptr<HeightField>>(m, "HeightField")
      .def(py::init(make), py::arg("heights").noconvert(), py::arg("origin"), py::arg("spacing"))
      .def_property_readonly("heights", heights)
      .def_property_readonly("origin",
                             [](const HeightField& self) { return triple(self.origin()); })
      .def_property_readonly("spacing", &HeightField::spacing)
      .def(py::pickle(
          [heights](const HeightField& self) {
            return py::make_tuple(heights(self), triple(self.origin()), self.spacing());
          },
          [make](const py::tuple& state) {
            return make(state[0].cast<Rows>(), state[1].cast<Triple>(), state[2].cast<double>());
          }));
}

// A shape as its number in Shape and what it is made of, and back.
py::tuple pack_shape(const Shape& shape) {
  struct Parts {
    py::object operator()(const Plane& s) const { return py::cast(triple(s.normal)); }
    py::object operator()(const Sphere& s) const { return py::cast(s.radius); }
    py::object operator()(const Box& s) const { return py::cast(triple(s.half_lengths)); }
    py::object operator()(const std::shared_ptr<const SampledDistance>& s) const {
      return py::cast(std::const_pointer_cast<SampledDistance>(s));
    }
    py::object operator()(const Capsule& s) const {
      return py::make_tuple(s.radius, s.half_length);
    }
    py::object operator()(const Cylinder& s) const {
      return py::make_tuple(s.radius, s.half_length);
    }
    py::object operator()(const std::shared_ptr<const HeightField>& s) const {
      return py::cast(std::const_pointer_cast<HeightField>(s));
    }
    py::object operator()(const Triangle& s) const {
      return py::make_tuple(triple(s.a), triple(s.b), triple(s.c), s.radius);
    }
  };
  return py::make_tuple(shape.index(), std::visit(Parts{}, shape));
}
Shape unpack_shape(const py::tuple& packed) {
  switch (packed[0].cast<int>()) {
    case 0:
      return Plane{vector(packed[1].cast<Triple>())};
    case 1:
      return Sphere{packed[1].cast<double>()};
    case 2:
      return Box{vector(packed[1].cast<Triple>())};
    case 3:
      return std::shared_ptr<const SampledDistance>(
          packed[1].cast<std::shared_ptr<SampledDistance>>());
    case 6:
      return std::shared_ptr<const HeightField>(packed[1].cast<std::shared_ptr<HeightField>>());
    case 7: {
      const auto [a, b, c, radius] = packed[1].cast<std::tuple<Triple, Triple, Triple, double>>();
      return Triangle{vector(a), vector(b), vector(c), radius};
    }
    default:
      const auto [radius, half_length] = packed[1].cast<std::pair<double, double>>();
      if (packed[0].cast<int>() == 4) return Capsule{radius, half_length};
      return Cylinder{radius, half_length};
  }
}

// A vector of a collider, read and written as three numbers.
template <class Get, class Set>
void vector_property(py::class_<Collider, std::shared_ptr<Collider>>& collider, const char* name,
                     Get get, Set set) {
  collider.def_property(
      name, [get](const Collider& self) { return triple(get(self)); },
      [set](Collider& self, const Triple& value) { set(self, vector(value)); });
}

using Rows64 = py::array_t<double, py::array::c_style | py::array::forcecast>;

// Puts a collider there, unless it is there but for rounding: what is known of its pose, such as
// distances on a grid, then is known still.
void place(Collider& collider, const Vec3& position, const Quaternion& orientation) {
  constexpr double kRounding = 1e-14;
  const double most = kRounding * position.cwiseAbs().maxCoeff();
  const bool there = (position - collider.position()).cwiseAbs().maxCoeff() <= most;
  const auto off = orientation.coeffs() - collider.orientation().coeffs();
  if (there && off.cwiseAbs().maxCoeff() <= kRounding) return;
  collider.set_position(position);
  collider.set_orientation(orientation);
}

// What obstacles know of the bodies behind them, a row for each.
void bind_bodies_behind(py::module_& m) {
  m.def(
      "place_bodies",
      [](const std::vector<std::shared_ptr<Collider>>& colliders, const std::vector<int>& numbers,
         const Rows64& poses, const Rows64& velocities, const Rows64& centres,
         const Rows64& mobilities, const Rows64& accelerations) {
        for (std::size_t c = 0; c < colliders.size(); ++c) {
          const auto k = static_cast<py::ssize_t>(c);
          Collider& collider = *colliders[c];
          const double* pose = poses.data(k, 0);
          place(collider, Vec3(pose), Quaternion(pose[3], pose[4], pose[5], pose[6]));
          collider.body = {.number = numbers[c],
                           .centre = Vec3(centres.data(k, 0)),
                           .mobility = Mat6(mobilities.data(k, 0)),
                           .acceleration = Vec6(accelerations.data(k, 0))};
          collider.set_body_velocity(Vec6(velocities.data(k, 0)));
        }
      },
      py::arg("colliders"), py::arg("numbers"), py::arg("poses"), py::arg("velocities"),
      py::arg("centres"), py::arg("mobilities"), py::arg("accelerations"));
  // Facets, whose shape changes: rows of three corners. numbers: of their bodies.
  m.def(
      "place_facets",
      [](const std::vector<std::shared_ptr<Collider>>& colliders, const std::vector<int>& numbers,
         int surface, const Rows64& corners, const Rows64& velocities, const Rows64& mobilities,
         const Rows64& accelerations) {
        for (std::size_t c = 0; c < colliders.size(); ++c) {
          const auto k = static_cast<py::ssize_t>(c);
          Collider& collider = *colliders[c];
          const double* x = corners.data(k, 0);
          const Vec3 p(x), q(x + 3), r(x + 6), middle = (p + q + r) / 3;
          const double radius = std::get<Triangle>(collider.shape()).radius;
          collider.set_shape(Triangle{p - middle, q - middle, r - middle, radius});
          collider.set_position(middle);
          collider.set_orientation(Quaternion::Identity());
          collider.body = {.number = numbers[c],
                           .mobility = Mat6(mobilities.data(k, 0)),
                           .acceleration = Vec6(accelerations.data(k, 0)),
                           .surface = surface};
          collider.set_body_velocity(Vec6(velocities.data(k, 0)));
        }
      },
      py::arg("colliders"), py::arg("numbers"), py::arg("surface"), py::arg("corners"),
      py::arg("velocities"), py::arg("mobilities"), py::arg("accelerations"));
  // Of all of them in a box, within so long.
  m.def(
      "largest_speed",
      [](const std::vector<std::shared_ptr<Collider>>& colliders, const Triple& low,
         const Triple& high, double time) {
        double most = 0;
        for (const auto& collider : colliders)
          most = std::max(
              most, substep::geometry::largest_speed(*collider, vector(low), vector(high), time));
        return most;
      },
      py::arg("colliders"), py::arg("low"), py::arg("high"), py::arg("time"));
  m.def(
      "release_bodies",
      [](const std::vector<std::shared_ptr<Collider>>& colliders) {
        for (const auto& collider : colliders) collider->body = {};
      },
      py::arg("colliders"));
  m.def(
      "collider_states",
      [](const std::vector<std::shared_ptr<Collider>>& colliders) {
        Rows64 rows({static_cast<py::ssize_t>(colliders.size()),
                     static_cast<py::ssize_t>(Collider::kStateSize)});
        for (std::size_t c = 0; c < colliders.size(); ++c) {
          const auto state = colliders[c]->state();
          std::copy(state.begin(), state.end(), rows.mutable_data(static_cast<py::ssize_t>(c), 0));
        }
        return rows;
      },
      py::arg("colliders"));
  m.def(
      "impulses_of_bodies",
      [](const std::vector<std::shared_ptr<Collider>>& colliders) {
        Rows64 rows({static_cast<py::ssize_t>(colliders.size()), py::ssize_t{6}});
        for (std::size_t c = 0; c < colliders.size(); ++c) {
          Eigen::Map<Vec6>{rows.mutable_data(static_cast<py::ssize_t>(c), 0)} =
              colliders[c]->body.received;
        }
        return rows;
      },
      py::arg("colliders"));
}

void bind_collider(py::module_& m) {
  py::class_<Collider, std::shared_ptr<Collider>> collider(m, "Collider");
  collider
      .def_static(
          "plane",
          [](const Triple& point, const Triple& normal) {
            return std::make_shared<Collider>(Plane{vector(normal)}, vector(point));
          },
          py::arg("point"), py::arg("normal"))
      .def_static(
          "sphere",
          [](const Triple& center, double radius, bool hollow) {
            return std::make_shared<Collider>(Sphere{radius}, vector(center), hollow);
          },
          py::arg("center"), py::arg("radius"), py::arg("hollow"))
      .def_static(
          "box",
          [](const Triple& center, const Triple& half_lengths, bool hollow) {
            return std::make_shared<Collider>(Box{vector(half_lengths)}, vector(center), hollow);
          },
          py::arg("center"), py::arg("half_lengths"), py::arg("hollow"))
      .def_static(
          "capsule",
          [](const Triple& center, double radius, double half_length, bool hollow) {
            return std::make_shared<Collider>(Capsule{radius, half_length}, vector(center), hollow);
          },
          py::arg("center"), py::arg("radius"), py::arg("half_length"), py::arg("hollow"))
      .def_static(
          "cylinder",
          [](const Triple& center, double radius, double half_length, bool hollow) {
            return std::make_shared<Collider>(Cylinder{radius, half_length}, vector(center),
                                              hollow);
          },
          py::arg("center"), py::arg("radius"), py::arg("half_length"), py::arg("hollow"))
      .def_static(
          "triangle",
          [](const Triple& a, const Triple& b, const Triple& c, double radius) {
            const Vec3 p = vector(a), q = vector(b), r = vector(c), middle = (p + q + r) / 3;
            return std::make_shared<Collider>(Triangle{p - middle, q - middle, r - middle, radius},
                                              middle);
          },
          py::arg("a"), py::arg("b"), py::arg("c"), py::arg("radius"))
      .def_static(
          "sampled",
          [](const std::shared_ptr<SampledDistance>& field, const Triple& position, bool hollow) {
            return std::make_shared<Collider>(std::shared_ptr<const SampledDistance>(field),
                                              vector(position), hollow);
          },
          py::arg("field"), py::arg("position"), py::arg("hollow"))
      .def_static(
          "height_field",
          [](const std::shared_ptr<HeightField>& field, const Triple& position) {
            return std::make_shared<Collider>(std::shared_ptr<const HeightField>(field),
                                              vector(position));
          },
          py::arg("field"), py::arg("position"))
      .def_readwrite("friction", &Collider::friction)
      .def_readwrite("restitution", &Collider::restitution)
      .def_property_readonly("lipschitz", &Collider::lipschitz)
      .def_property_readonly("hollow", &Collider::hollow)
      .def_property_readonly("impulse",
                             [](const Collider& self) { return triple(self.total().impulse); })
      .def_property_readonly("angular_impulse",
                             [](const Collider& self) { return triple(self.total().torque); })
      .def_property_readonly("duration", &Collider::duration)
      .def("begin_call", &Collider::begin_call)
      .def("end_step", &Collider::end_step, py::arg("dt"))
      .def_property(
          "orientation",
          [](const Collider& self) {
            const Quaternion& q = self.orientation();
            return std::array<double, 4>{q.w(), q.x(), q.y(), q.z()};
          },
          [](Collider& self, const std::array<double, 4>& q) {
            self.set_orientation(Quaternion(q[0], q[1], q[2], q[3]));
          })
      .def_property("state", &Collider::state, &Collider::restore)
      // Of a facet, in its frame: what it goes on from beside that, as it deforms.
      .def_property(
          "corners",
          [](const Collider& self) {
            const auto& [a, b, c, radius] = std::get<Triangle>(self.shape());
            return std::array<double, 9>{a.x(), a.y(), a.z(), b.x(), b.y(),
                                         b.z(), c.x(), c.y(), c.z()};
          },
          [](Collider& self, const std::array<double, 9>& x) {
            const double radius = std::get<Triangle>(self.shape()).radius;
            self.set_shape(Triangle{Vec3(&x[0]), Vec3(&x[3]), Vec3(&x[6]), radius});
          })
      // By hand, of one: for tests.
      .def(
          "set_body",
          [](Collider& self, int number, const Triple& centre,
             const std::array<double, 36>& mobility, const std::array<double, 6>& acceleration) {
            self.body = {.number = number,
                         .centre = vector(centre),
                         .mobility = Mat6(mobility.data()),
                         .acceleration = Vec6(acceleration.data())};
          },
          py::arg("number"), py::arg("centre"), py::arg("mobility"), py::arg("acceleration"))
      .def_property_readonly("received",
                             [](const Collider& self) {
                               std::array<double, 6> received;
                               Eigen::Map<Vec6>{received.data()} = self.body.received;
                               return received;
                             })
      .def("copy", [](const Collider& self) { return std::make_shared<Collider>(self); })
      .def(
          "assign", [](Collider& self, const Collider& other) { self = other; }, py::arg("other"))
      .def(py::pickle(
          [](const Collider& self) {
            return py::make_tuple(pack_shape(self.shape()), self.hollow(), self.state());
          },
          [](const py::tuple& packed) {
            auto made = std::make_shared<Collider>(unpack_shape(packed[0].cast<py::tuple>()),
                                                   Vec3::Zero(), packed[1].cast<bool>());
            made->restore(packed[2].cast<std::array<double, Collider::kStateSize>>());
            return made;
          }))
      .def("advance", &Collider::advance, py::arg("dt"))
      .def(
          "distance",
          [](const Collider& self, const Rows& x, int threads) {
            return for_points(x, {}, threads, [&](const Vec3& point, double* out) {
              *out = self.signed_distance(point).value;
            });
          },
          py::arg("x").noconvert(), py::arg("threads"))
      .def(
          "gradient",
          [](const Collider& self, const Rows& x, int threads) {
            return for_points(x, {3}, threads, [&](const Vec3& point, double* out) {
              Eigen::Map<Vec3>{out} = self.signed_distance(point).gradient;
            });
          },
          py::arg("x").noconvert(), py::arg("threads"))
      .def(
          "hessian",
          [](const Collider& self, const Rows& x, int threads) {
            return for_points(x, {3, 3}, threads, [&](const Vec3& point, double* out) {
              Eigen::Map<Mat3>{out} = self.hessian(point);
            });
          },
          py::arg("x").noconvert(), py::arg("threads"))
      .def(
          "surface_velocity",
          [](const Collider& self, const Rows& x, int threads) {
            return for_points(x, {3}, threads, [&](const Vec3& point, double* out) {
              Eigen::Map<Vec3>{out} = self.surface_velocity(point);
            });
          },
          py::arg("x").noconvert(), py::arg("threads"));
  vector_property(
      collider, "position", [](const Collider& self) { return self.position(); },
      [](Collider& self, const Vec3& value) { self.set_position(value); });
  vector_property(
      collider, "velocity", [](const Collider& self) { return self.velocity; },
      [](Collider& self, const Vec3& value) { self.velocity = value; });
  vector_property(
      collider, "angular_velocity", [](const Collider& self) { return self.angular_velocity; },
      [](Collider& self, const Vec3& value) { self.angular_velocity = value; });
}

void bind_triangle_tree(py::module_& m) {
  py::class_<TriangleTree>(m, "TriangleTree")
      .def(py::init([](const Rows& vertices, const LongIndices& faces) {
             const double* x = vertices.data();
             const std::int64_t* f = faces.data();
             const auto count = faces.shape(0);
             for (const std::int64_t corner : readable(faces)) check_row(corner, vertices.shape(0));
             const py::gil_scoped_release nogil;
             return std::make_unique<TriangleTree>(x, f, count);
           }),
           py::arg("vertices").noconvert(), py::arg("faces").noconvert())
      .def_property_readonly("closed", &TriangleTree::closed)
      // Rows of distance, nearest point, face.
      .def(
          "nearest",
          [](const TriangleTree& self, const Rows& x, int threads) {
            return for_points(x, {5}, threads, [&](const Vec3& point, double* out) {
              const TriangleTree::Nearest near = self.nearest(point);
              out[0] = near.distance;
              Eigen::Map<Vec3>{out + 1} = near.point;
              out[4] = static_cast<double>(near.face);
            });
          },
          py::arg("x").noconvert(), py::arg("threads"))
      .def(
          "winding_number",
          [](const TriangleTree& self, const Rows& x, int threads) {
            return for_points(x, {}, threads, [&](const Vec3& point, double* out) {
              *out = self.winding_number(point);
            });
          },
          py::arg("x").noconvert(), py::arg("threads"))
      .def(
          "signed_distance",
          [](const TriangleTree& self, const Rows& x, int threads) {
            return for_points(x, {}, threads, [&](const Vec3& point, double* out) {
              *out = self.signed_distance(point);
            });
          },
          py::arg("x").noconvert(), py::arg("threads"))
      .def(
          "count_pierced",
          [](const TriangleTree& self, const Rows& vertices, const LongIndices& faces,
             const LongIndices& edges, int threads) {
            const double* x = vertices.data();
            const std::int64_t* f = faces.data();
            const std::int64_t* e = edges.data();
            const auto count = edges.shape(0);
            const py::gil_scoped_release nogil;
            return self.count_pierced(x, f, e, count, threads);
          },
          py::arg("vertices").noconvert(), py::arg("faces").noconvert(),
          py::arg("edges").noconvert(), py::arg("threads"))
      .def(
          "sample",
          [](const TriangleTree& self, const std::array<std::int64_t, 3>& shape,
             const Triple& origin, double spacing, int threads) {
            Rows values({shape[0], shape[1], shape[2]});
            double* out = values.mutable_data();
            const py::gil_scoped_release nogil;
            sample_signed_distance(self, shape, vector(origin), spacing, out, threads);
            return values;
          },
          py::arg("shape"), py::arg("origin"), py::arg("spacing"), py::arg("threads"))
      .def(
          "stuff",
          [](const TriangleTree& self, double spacing, int threads) {
            const auto filled = [&] {
              const py::gil_scoped_release nogil;
              return stuff_isosurface(self, spacing, threads);
            }();
            Rows vertices({static_cast<py::ssize_t>(filled.vertices.size()), py::ssize_t{3}});
            LongIndices cells({static_cast<py::ssize_t>(filled.cells.size()), py::ssize_t{4}});
            double* x = vertices.mutable_data();
            for (const Vec3& v : filled.vertices) x = std::copy_n(v.data(), 3, x);
            std::int64_t* c = cells.mutable_data();
            for (const auto& cell : filled.cells) c = std::copy_n(cell.data(), 4, c);
            return py::make_tuple(vertices, cells);
          },
          py::arg("spacing"), py::arg("threads"));
}

template <int D>
Rows poisson_disk_rows(const std::vector<double>& size, double radius, int trials,
                       std::uint64_t seed, int threads) {
  std::array<double, D> sides;
  std::copy_n(size.begin(), D, sides.begin());
  const auto points = [&] {
    const py::gil_scoped_release nogil;
    return poisson_disk<D>(sides, radius, trials, seed, threads);
  }();
  Rows rows({static_cast<py::ssize_t>(points.size()), py::ssize_t{D}});
  double* out = rows.mutable_data();
  for (const auto& x : points) out = std::copy_n(x.data(), D, out);
  return rows;
}

}  // namespace

void bind_geometry(py::module_& m) {
  m.def(
      "poisson_disk",
      [](const std::vector<double>& size, double radius, int trials, std::uint64_t seed,
         int threads) {
        return size.size() == 2 ? poisson_disk_rows<2>(size, radius, trials, seed, threads)
                                : poisson_disk_rows<3>(size, radius, trials, seed, threads);
      },
      py::arg("size"), py::arg("radius"), py::arg("trials"), py::arg("seed"), py::arg("threads"));
  bind_triangle_tree(m);
  bind_sampled_distance(m);
  bind_height_field(m);
  bind_collider(m);
  bind_bodies_behind(m);
}
