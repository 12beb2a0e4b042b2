#include <pybind11/stl.h>

#include <algorithm>

#include "rigid_world.h"
#include "substep/core/errors.h"
#include "substep/rigid/solver/joint.h"

namespace rigid_binding {
namespace {

// All numbers of a contact that are not integers, in one order: visit(double&).
template <class Contact, class Visit>
void for_each_real(Contact& c, Visit&& visit) {
  const auto vector = [&](auto& v) {
    for (int i = 0; i < 3; ++i) visit(v[i]);
  };
  vector(c.normal), vector(c.tangent);
  for (auto& point : c.points) {
    vector(point.position), vector(point.in_a), vector(point.in_b);
    vector(point.arm_a), vector(point.arm_b);
    visit(point.separation), visit(point.impulse), visit(point.total);
  }
  visit(c.friction), visit(c.static_friction), visit(c.restitution);
  visit(c.spinning), visit(c.rolling);
  for (auto& u : c.slip) visit(u);
  visit(c.friction_impulse[0]), visit(c.friction_impulse[1]), visit(c.twist_impulse);
  visit(c.roll_impulse[0]), visit(c.roll_impulse[1]);
  visit(c.friction_total[0]), visit(c.friction_total[1]), visit(c.load);
}
template <class Contact, class Visit>
void for_each_integer(Contact& c, Visit&& visit) {
  visit(c.a), visit(c.b), visit(c.fixture_a), visit(c.fixture_b), visit(c.count);
  visit(c.slips);
}

template <class Value, class Visit>
void for_each_real_of_joint(Value& joint, Visit&& visit) {
  const auto frame = [&](auto& f) {
    for (int i = 0; i < 3; ++i) visit(f.anchor[i]);
    for (int i = 0; i < 4; ++i) visit(f.axes.coeffs()[i]);
  };
  frame(joint.in_a), frame(joint.in_b);
  visit(joint.lower), visit(joint.upper), visit(joint.cone);
  visit(joint.motor.target), visit(joint.motor.stiffness), visit(joint.motor.damping);
  visit(joint.motor.most);
  for (int i = 0; i < 3; ++i) visit(joint.spring.rest[i]);
  visit(joint.spring.twist_stiffness), visit(joint.spring.swing_stiffness);
  visit(joint.spring.twist_damping), visit(joint.spring.swing_damping);
  for (auto& value : joint.impulse) visit(value);
  visit(joint.effort), visit(joint.coordinate);
  for (int i = 0; i < 3; ++i) visit(joint.force[i]);
  for (int i = 0; i < 3; ++i) visit(joint.torque[i]);
  visit(joint.length_error), visit(joint.angle_error);
}
template <class Value, class Visit>
void for_each_integer_of_joint(Value& joint, Visit&& visit) {
  visit(joint.type), visit(joint.a), visit(joint.b), visit(joint.motor.type), visit(joint.collide);
}

template <class Each, class Item>
py::ssize_t length(Each each, Item& item) {
  py::ssize_t n = 0;
  each(item, [&](auto&) { ++n; });
  return n;
}

// One row of numbers for each item, by for_each_real or for_each_integer.
template <class T, class Item, class Each>
py::array_t<T> pack(const std::vector<Item>& items, Each each) {
  Item none{};
  py::array_t<T> rows({static_cast<py::ssize_t>(items.size()), length(each, none)});
  T* out = rows.mutable_data();
  for (const Item& item : items)
    each(item, [&](const auto& value) { *out++ = static_cast<T>(value); });
  return rows;
}
template <class T, class Item, class Each>
void unpack(const py::dict& state, const char* name, std::vector<Item>& items, Each each) {
  const auto rows = state[name].cast<py::array_t<T, py::array::c_style>>();
  Item none{};
  items.resize(static_cast<std::size_t>(rows.shape(0)));
  if (rows.ndim() != 2 || rows.shape(1) != length(each, none))
    throw substep::InputError("state['" + std::string(name) + "']: expected " +
                              std::to_string(length(each, none)) + " columns");
  const T* in = rows.data();
  for (Item& item : items)
    each(item, [&](auto& value) { value = static_cast<std::decay_t<decltype(value)>>(*in++); });
}

const auto kReals = [](auto& item, auto&& visit) { for_each_real(item, visit); };
const auto kIntegers = [](auto& item, auto&& visit) { for_each_integer(item, visit); };
const auto kJointReals = [](auto& item, auto&& visit) { for_each_real_of_joint(item, visit); };
const auto kJointIntegers = [](auto& item, auto&& visit) {
  for_each_integer_of_joint(item, visit);
};
const auto kPair = [](auto& pair, auto&& visit) { visit(pair.a), visit(pair.b); };
const auto kNumbers = [](auto& numbers, auto&& visit) {
  for (auto& value : numbers) visit(value);
};

// The names of all pairs, each ended by 0.
py::array_t<std::uint8_t> pack_names(const std::vector<MaterialPair>& pairs) {
  std::string names;
  for (const MaterialPair& pair : pairs) names += pair.a + '\0' + pair.b + '\0';
  return py::array_t<std::uint8_t>(static_cast<py::ssize_t>(names.size()),
                                   reinterpret_cast<const std::uint8_t*>(names.data()));
}
std::vector<std::string> unpack_names(const py::dict& state) {
  const auto letters =
      state["material_names"].cast<py::array_t<std::uint8_t, py::array::c_style>>();
  std::vector<std::string> names;
  const std::uint8_t *next = letters.data(), *end = next + letters.size();
  while (next != end) {
    const std::uint8_t* stop = std::find(next, end, 0);
    if (stop == end || stop == next) throw substep::InputError("state['material_names']: cut off");
    names.emplace_back(next, stop);
    next = stop + 1;
  }
  return names;
}

constexpr const char* kBodyArrays[] = {"positions",       "rotations", "momenta",
                                       "angular_momenta", "forces",    "torques"};

}  // namespace

py::dict state_of(WorldState s) {
  py::dict state;
  state["time"] = s.time;
  state["steps"] = s.steps;
  const auto n = static_cast<py::ssize_t>(s.bodies.size());
  const auto arrays = PyWorld::arrays(s.bodies);
  for (std::size_t k = 0; k < arrays.size(); ++k)
    state[kBodyArrays[k]] = Rows({n, py::ssize_t{k == 1 ? 4 : 3}}, arrays[k]->data());
  state["masses"] = column(s.bodies.mass);
  state["inertia"] = Rows({n, py::ssize_t{3}}, s.bodies.inertia.data());
  state["motions"] = motions_of(s.bodies);
  state["rest_positions"] = Rows({n, py::ssize_t{3}}, s.rest_x.data());
  state["rest_rotations"] = Rows({n, py::ssize_t{4}}, s.rest_q.data());
  state["placed_positions"] = Rows({n, py::ssize_t{3}}, s.placed_x.data());
  state["placed_rotations"] = Rows({n, py::ssize_t{4}}, s.placed_q.data());
  state["slow_time"] = column(s.slow_time);
  state["island"] = column(s.island);
  state["excluded"] = pack<std::int32_t>(s.excluded, kPair);
  std::vector<std::array<double, 5>> surfaces;
  for (const MaterialPair& pair : s.material_pairs) surfaces.push_back(numbers_of(pair));
  state["material_names"] = pack_names(s.material_pairs);
  state["material_pairs"] = pack<double>(surfaces, kNumbers);
  state["contacts"] = pack<double>(s.contacts, kReals);
  state["contact_pairs"] = pack<std::int32_t>(s.contacts, kIntegers);
  state["joints"] = pack<double>(s.joints, kJointReals);
  state["joint_pairs"] = pack<std::int32_t>(s.joints, kJointIntegers);
  return state;
}

void restore_state(PyWorld& self, const py::dict& state) {
  WorldState s = self.world.state();
  s.time = state["time"].cast<double>();
  s.steps = state["steps"].cast<std::int64_t>();
  const auto arrays = PyWorld::arrays(s.bodies);
  const auto read = [&](const char* name, auto& values) {
    const auto given = state[name]
                           .cast<py::array_t<typename std::decay_t<decltype(values)>::value_type,
                                             py::array::c_style>>();
    if (static_cast<std::size_t>(given.size()) != values.size())
      throw substep::InputError("state['" + std::string(name) + "']: expected " +
                                std::to_string(values.size()) + " numbers, got " +
                                std::to_string(given.size()));
    std::copy_n(given.data(), values.size(), values.begin());
  };
  for (std::size_t k = 0; k < arrays.size(); ++k) read(kBodyArrays[k], *arrays[k]);
  read("masses", s.bodies.mass), read("inertia", s.bodies.inertia);
  std::vector<std::uint8_t> motions(s.bodies.motion.size());
  read("motions", motions);
  for (std::size_t i = 0; i < motions.size(); ++i)
    s.bodies.motion[i] = static_cast<Motion>(motions[i]);
  read("slow_time", s.slow_time), read("island", s.island);
  read("rest_positions", s.rest_x), read("rest_rotations", s.rest_q);
  read("placed_positions", s.placed_x), read("placed_rotations", s.placed_q);
  unpack<std::int32_t>(state, "excluded", s.excluded, kPair);
  std::vector<std::array<double, 5>> surfaces;
  unpack<double>(state, "material_pairs", surfaces, kNumbers);
  const std::vector<std::string> names = unpack_names(state);
  if (names.size() != 2 * surfaces.size())
    throw substep::InputError("state['material_names']: expected two for each of material_pairs");
  s.material_pairs.clear();
  for (std::size_t k = 0; k < surfaces.size(); ++k)
    s.material_pairs.push_back(material_pair(names[2 * k], names[2 * k + 1], surfaces[k]));
  unpack<double>(state, "contacts", s.contacts, kReals);
  unpack<std::int32_t>(state, "contact_pairs", s.contacts, kIntegers);
  unpack<double>(state, "joints", s.joints, kJointReals);
  unpack<std::int32_t>(state, "joint_pairs", s.joints, kJointIntegers);
  self.with_same_bodies([&] { self.world.restore(s); });
}

}  // namespace rigid_binding
