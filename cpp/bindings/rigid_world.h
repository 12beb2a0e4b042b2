// The world of rigid bodies as Python has it: its arrays can be views.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "arrays.h"
#include "substep/rigid/world/world.h"

namespace rigid_binding {

using namespace substep::rigid;

using Rows = py::array_t<double, py::array::c_style>;
using Numbers = py::array_t<std::int64_t, py::array::c_style>;
using Flags = py::array_t<std::uint8_t, py::array::c_style>;
using Integers = py::array_t<std::int32_t, py::array::c_style>;

struct RigidShape {
  Shape shape;
};

// The arrays of bodies that have views: x, q, P, L, force, torque.
using RowArrays = std::array<std::vector<double>, 6>;

// What views hold on to. It keeps the world alive as long as they are views of its arrays, and the
// arrays themselves from then on.
struct ViewOwner {
  py::object world;
  RowArrays arrays;
};

struct PyWorld {
  World world;
  std::weak_ptr<ViewOwner> views;

  // Rows of bodies that there are.
  std::span<const std::int64_t> bodies(const Numbers& rows) const {
    return rows_in(rows, world.bodies().size());
  }

  static std::array<std::vector<double>*, 6> arrays(Bodies& b) {
    return {&b.x, &b.q, &b.P, &b.L, &b.force, &b.torque};
  }

  // Moves the arrays out; the world has copies.
  RowArrays take_arrays();
  void put_arrays(RowArrays&& taken);

  // Calls change(), after which the world has other bodies: views stay with the arrays that they
  // are of, and see them no more. Where it throws, the world must be as before; so are the views.
  template <class Change>
  void with_other_bodies(Change&& change) {
    const std::shared_ptr<ViewOwner> owner = views.lock();
    if (!owner) return change();
    RowArrays old = take_arrays();
    try {
      change();
    } catch (...) {
      put_arrays(std::move(old));
      throw;
    }
    owner->arrays = std::move(old);
    views.reset();
    owner->world = py::none();  // may be the last but one that holds it
  }

  // Calls change(), which may replace the arrays, but by others of the same size: views see them.
  template <class Change>
  void with_same_bodies(Change&& change) {
    if (views.expired()) return change();
    RowArrays old = take_arrays();
    try {
      change();
    } catch (...) {
      put_arrays(std::move(old));
      throw;
    }
    const auto now = arrays(world.bodies());
    for (std::size_t k = 0; k < old.size(); ++k)
      std::copy(now[k]->begin(), now[k]->end(), old[k].begin());
    put_arrays(std::move(old));
  }
};

// Friction, static friction, restitution, rolling and spinning levers; NaN where it follows the
// rule.
std::array<double, 5> numbers_of(const MaterialPair& pair);
MaterialPair material_pair(const std::string& a, const std::string& b,
                           const std::array<double, 5>& numbers);

inline std::span<const std::int64_t> numbers(const Numbers& a) {
  return {a.data(), static_cast<std::size_t>(a.size())};
}

inline py::array_t<std::uint8_t> motions_of(const Bodies& bodies) {
  return made(
      py::array_t<std::uint8_t>(static_cast<py::ssize_t>(bodies.motion.size()),
                                reinterpret_cast<const std::uint8_t*>(bodies.motion.data())));
}

py::dict state_of(WorldState state);
// InputError where it does not fit; nothing changed then.
void restore_state(PyWorld& world, const py::dict& state);

void bind_joints(py::class_<PyWorld>& world);
void bind_rigid_batch(py::module_& m);
void bind_queries(py::class_<PyWorld>& world);

}  // namespace rigid_binding
