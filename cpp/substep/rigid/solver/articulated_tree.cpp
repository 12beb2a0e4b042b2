#include "substep/rigid/solver/articulated_tree.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/atan2.h"
#include "substep/core/matrix3.h"
#include "substep/core/point_scatter.h"

namespace substep::rigid {
namespace {

using Kind = ArticulatedTree::Kind;

constexpr double kSmallTurn = 0.01;  // square of a sine, below which series are exact

// q turned by Cayley's map of a.
Quaternion turned(const Quaternion& q, const Vec3& a) {
  const Vec3 half = 0.5 * a;
  return (Quaternion(1, half[0], half[1], half[2]) * q).normalized();
}

QuadMatrix rotation(const Quaternion& q) { return QuadMatrix::of(q.toRotationMatrix()); }

using V = Vector<double>;
constexpr int kLanes = sizeof(V) / sizeof(double);
using Lanes3 = Vector3<V>;

// Of vectors at(0), at(1), ... by lane.
template <class At>
SUBSTEP_INLINE Lanes3 gather_vectors(const At& at) {
  const auto p =
      load_rows<V>([&](int lane) { return reinterpret_cast<const Point<double>*>(&at(lane)); });
  return {{p.x, p.y, p.z}};
}
template <class At>
SUBSTEP_INLINE void scatter_vectors(const Lanes3& v, const At& at) {
  store_rows<V>({v[0], v[1], v[2], V{}},
                [&](int lane) { return reinterpret_cast<Point<double>*>(&at(lane)); });
}

// log(R0^T R1), in the coordinates of R0.
SUBSTEP_INLINE Lanes3 logarithm(const Lanes3 (&R0)[3], const Lanes3 (&R1)[3]) {
  Lanes3 sine;
  V trace = splat<V>(-1);
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    sine[i] = 0.5 * (dot(R0[k], R1[j]) - dot(R0[j], R1[k]));
    trace += dot(R0[i], R1[i]);
  }
  const V s = dot(sine, sine);
  constexpr double kArcsine[] = {143. / 10240, 231. / 13312, 63. / 2816, 35. / 1152,
                                 5. / 112,     3. / 40,      1. / 6,     1.};
  V ratio{};
  for (const double a : kArcsine) ratio = ratio * s + a;
  const auto large = (s > kSmallTurn) | (trace < 0.0);
  if (any(large)) {
    const V root = square_root(s);
    ratio = select(large, V(atan2<V>(root, V(0.5 * trace)) / root), ratio);
  }
  return ratio * sine;
}

// J^-T v for the left rates J of the logarithm: v + f x v / 2 + c f x (f x v).
SUBSTEP_INLINE Lanes3 left_momentum(const Lanes3& f, const Lanes3& v) {
  const V p = dot(f, f);
  const V c = 1. / 12 + p * (1. / 720 + p * (1. / 30240 + p * (1. / 1209600 + p / 47900160)));
  const Lanes3 across = cross(f, v);
  return v + splat<V>(0.5) * across + c * cross(f, across);
}

}  // namespace

ArticulatedTree::ArticulatedTree(std::vector<Part> parts)
    : parts_(std::move(parts)),
      articulated_(parts_.size()),
      response_(parts_.size()),
      inverse_(parts_.size()),
      wrench_(parts_.size()),
      angle_(parts_.size()) {}

void ArticulatedTree::place(std::span<const Coordinate> coordinates,
                            std::span<Place> places) const {
  const Place world;
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Part& part = parts_[k];
    const Coordinate& at = coordinates[k];
    Place& place = places[k];
    if (part.kind == Kind::kFree) {
      place.R = rotation(at.q);
      place.O = at.x;
    } else {
      const Place& parent = part.parent < 0 ? world : places[usize(part.parent)];
      place.d = parent.R * part.anchor;
      place.O = parent.O + place.d;
      const auto& turning = part.turning;
      switch (part.kind) {
        case Kind::kBall:
          place.R = rotation(at.q);
          break;
        case Kind::kHinge: {
          QuadMatrix relative = turning[0];
          for (int i = 0; i < 3; ++i)
            relative[i] += at.cosine * turning[1][i] + at.sine * turning[2][i];
          place.R = parent.R * relative;
          place.axis = parent.R * part.axis;
          break;
        }
        default:
          place.R = parent.R * turning[0];
      }
    }
    place.c = place.R * part.centre;
    place.x = place.O + place.c;
  }
}

void ArticulatedTree::advance(std::span<const Rate> rates, double h,
                              std::span<Coordinate> coordinates) const {
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Rate& rate = rates[k];
    Coordinate& at = coordinates[k];
    switch (parts_[k].kind) {
      case Kind::kHinge: {  // times (1 + i t) / (1 - i t)
        const double t = 0.5 * h * rate.angle, scale = 1 / (1 + t * t);
        const double c = scale * (1 - t * t), s = scale * 2 * t;
        const double cosine = at.cosine * c - at.sine * s, sine = at.sine * c + at.cosine * s;
        at.cosine = cosine, at.sine = sine;
        break;
      }
      case Kind::kFree:
        at.x += h * rate.linear;
        [[fallthrough]];
      case Kind::kBall:
        at.q = turned(at.q, h * vec(rate.angular));
        break;
      case Kind::kFixed:
        break;
    }
  }
}

void ArticulatedTree::find_momenta(std::span<const Place> from, std::span<const Place> to, double h,
                                   std::span<Momentum> momenta, std::span<Quad3> turns) const {
  for (std::size_t first = 0; first < parts_.size(); first += kLanes) {
    // Lanes that are left have the last part again.
    const auto part = [&](int lane) __attribute__((always_inline)) {
      return std::min(first + usize(lane), parts_.size() - 1);
    };
    const auto gather = [&](std::span<const Place> places,
                            const auto& member) __attribute__((always_inline)) {
      return gather_vectors([&](int lane) __attribute__((always_inline)) -> const Quad3& {
        return member(places[part(lane)]);
      });
    };
    Lanes3 R0[3], R1[3];
    for (int i = 0; i < 3; ++i) {
      const auto column = [i](const Place& at) -> const Quad3& { return at.R[i]; };
      R0[i] = gather(from, column), R1[i] = gather(to, column);
    }
    const Lanes3 f = logarithm(R0, R1);
    const auto in_world = [&](const Lanes3& v) __attribute__((always_inline)) {
      return v[0] * R0[0] + v[1] * R0[1] + v[2] * R0[2];
    };
    const auto inertia = load_rows<V>([&](int lane) __attribute__((always_inline)) {
      return reinterpret_cast<const Point<double>*>(&parts_[part(lane)].inertia);
    });
    const V mass = inertia.w;
    Lanes3 body;
    const V moments[] = {inertia.x, inertia.y, inertia.z};
    for (int i = 0; i < 3; ++i) body[i] = moments[i] * (f[i] / h);
    const auto centre = [](const Place& at) -> const Quad3& { return at.x; };
    const Lanes3 way = gather(to, centre) - gather(from, centre);
    Lanes3 linear;
    for (int i = 0; i < 3; ++i) linear[i] = mass * (way[i] / h);
    scatter_vectors(linear, [&](int lane) __attribute__((always_inline)) -> Quad3& {
      return momenta[part(lane)].linear;
    });
    scatter_vectors(in_world(left_momentum(f, body)),
                    [&](int lane) __attribute__((always_inline)) -> Quad3& {
                      return momenta[part(lane)].angular;
                    });
    if (!turns.empty())
      scatter_vectors(in_world(f), [&](int lane) __attribute__((always_inline)) -> Quad3& {
        return turns[part(lane)];
      });
  }
}

void ArticulatedTree::factor(std::span<const Place> places) {
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Part& part = parts_[k];
    const Place& place = places[k];
    Articulated& own = articulated_[k];
    const double mass = part.inertia[3];
    const Quad3 mc = mass * place.c;
    const double square = dot(mc, place.c);
    for (int i = 0; i < 3; ++i) {  // R I R^T + m (c^2 - c c^T), m [c], m
      own.J[i] = part.seen_inertia[0] * place.R[0][i] * place.R[0] +
                 part.seen_inertia[1] * place.R[1][i] * place.R[1] +
                 part.seen_inertia[2] * place.R[2][i] * place.R[2] - mc[i] * place.c;
      own.J[i][i] += square;
      own.M[i] = Quad3{};
      own.M[i][i] = mass;
    }
    own.H = {quad(0, mc[2], -mc[1]), quad(-mc[2], 0, mc[0]), quad(mc[1], -mc[0], 0)};
  }
  for (std::size_t k = parts_.size(); k-- > 0;) reduce(k, places[k]);
}

// What the part's joint leaves of its inertia, to its parent.
void ArticulatedTree::reduce(std::size_t k, const Place& place) {
  const Part& part = parts_[k];
  const Articulated& own = articulated_[k];
  Response& response = response_[k];
  response.d = place.d;
  response.c = place.c;
  QuadMatrix J = own.J, H = own.H, M = own.M;
  if (part.kind == Kind::kHinge) {
    response.axis = place.axis;
    response.torque = J * place.axis;
    response.force = transposed_product(H, place.axis);
    response.inverse = 1 / dot(place.axis, response.torque);
    const Quad3 torque = response.inverse * response.torque;
    const Quad3 force = response.inverse * response.force;
    J = J - outer(torque, response.torque);
    H = H - outer(torque, response.force);
    M = M - outer(force, response.force);
  } else if (part.kind != Kind::kFixed) {
    Inverse& of = inverse_[k];
    of.J = inverse(J);
    of.K = of.J * H;
    M = M - transpose(H) * of.K;
    if (part.kind == Kind::kFree) {
      of.M = inverse(M);
      return;
    }
    J = H = {};
  }
  if (part.parent < 0) return;
  Articulated& parent = articulated_[usize(part.parent)];
  const QuadMatrix G = H + cross(place.d, M);
  // J - H [d] + [d] G^T
  parent.J = parent.J + J + transpose(cross(place.d, transpose(H))) + cross(place.d, transpose(G));
  parent.H = parent.H + G;
  parent.M = parent.M + M;
}

void ArticulatedTree::respond(std::span<const Momentum> momenta, std::span<Rate> rates) {
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Momentum& m = momenta[k];
    wrench_[k] = {m.linear, m.angular + cross(response_[k].c, m.linear)};
  }
  for (std::size_t k = parts_.size(); k-- > 0;) {
    const Part& part = parts_[k];
    const Response& own = response_[k];
    Quad3 force = wrench_[k].linear, torque = wrench_[k].angular;
    if (part.kind == Kind::kHinge) {
      const double u = angle_[k] = own.inverse * dot(own.axis, torque);
      force -= u * own.force;
      torque -= u * own.torque;
    } else if (part.kind != Kind::kFixed) {
      force -= transposed_product(inverse_[k].K, torque);
      torque = Quad3{};
      wrench_[k].linear = force;
    }
    if (part.parent < 0) continue;
    Momentum& parent = wrench_[usize(part.parent)];
    parent.linear += force;
    parent.angular += torque + cross(own.d, force);
  }
  const Rate rest;
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Part& part = parts_[k];
    const Response& own = response_[k];
    Rate& rate = rates[k];
    if (part.kind == Kind::kFree) {
      rate.linear = inverse_[k].M * wrench_[k].linear;
      rate.angular = inverse_[k].J * wrench_[k].angular - inverse_[k].K * rate.linear;
      continue;
    }
    const Rate& parent = part.parent < 0 ? rest : rates[usize(part.parent)];
    rate.linear = parent.linear - cross(own.d, parent.angular);
    if (part.kind == Kind::kHinge) {
      rate.angle =
          angle_[k] - own.inverse * (dot(own.torque, parent.angular) + dot(own.force, rate.linear));
      rate.angular = parent.angular + rate.angle * own.axis;
    } else if (part.kind == Kind::kBall) {
      rate.angular = inverse_[k].J * wrench_[k].angular - inverse_[k].K * rate.linear;
    } else {
      rate.angular = parent.angular;
    }
  }
}

ArticulatedTree::Momentum ArticulatedTree::momentum(std::size_t k, const Place& place,
                                                    const Rate& rate) const {
  const Part& part = parts_[k];
  const Quad3 spin = part.inertia * transposed_product(place.R, rate.angular);
  return {part.inertia[3] * (rate.linear + cross(rate.angular, place.c)), place.R * spin};
}

}  // namespace substep::rigid
