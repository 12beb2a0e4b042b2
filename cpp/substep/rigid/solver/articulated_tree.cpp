#include "substep/rigid/solver/articulated_tree.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "substep/core/atan2.h"
#include "substep/core/matrix3.h"
#include "substep/core/point_scatter.h"
#include "substep/rigid/motion/body_lanes.h"

namespace substep::rigid {
namespace {

using Kind = ArticulatedTree::Kind;

bool has_coordinate(Kind kind) { return kind == Kind::kHinge || kind == Kind::kSlider; }

constexpr double kSmallTurn = 0.01;  // square of a sine, below which series are exact

// q turned by Cayley's map of a, and longer by that.
Quaternion turned(const Quaternion& q, const Vec3& a) {
  const Vec3 half = 0.5 * a;
  return Quaternion(1, half[0], half[1], half[2]) * q;
}

// Of q of any length.
QuadMatrix rotation(const Quaternion& q) {
  const double scale = 2 / q.squaredNorm();
  const double w = scale * q.w(), x = scale * q.x(), y = scale * q.y(), z = scale * q.z();
  const double xx = x * q.x(), yy = y * q.y(), zz = z * q.z();
  const double xy = x * q.y(), xz = x * q.z(), yz = y * q.z();
  const double wx = w * q.x(), wy = w * q.y(), wz = w * q.z();
  return {quad(1 - (yy + zz), xy + wz, xz - wy), quad(xy - wz, 1 - (xx + zz), yz + wx),
          quad(xz + wy, yz - wx, 1 - (xx + yy))};
}

using V = Vector<double>;
using Lanes3 = Vector3<V>;

// Of pairs of vectors that begin at at(0), at(1), ... by lane.
template <class At>
SUBSTEP_INLINE BodyLanes gather_pairs(const At& at) {
  return load_bodies([&](int lane) __attribute__((always_inline)) {
    return reinterpret_cast<const BodyRow*>(&at(lane));
  });
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

// R v
SUBSTEP_INLINE Lanes3 in_world(const Lanes3 (&R)[3], const Lanes3& v) {
  return v[0] * R[0] + v[1] * R[1] + v[2] * R[2];
}

// D A of a diagonal D.
QuadMatrix scaled(const Quad3& D, const QuadMatrix& A) { return {D * A[0], D * A[1], D * A[2]}; }

}  // namespace

ArticulatedTree::ArticulatedTree(std::vector<Part> parts)
    : parts_(std::move(parts)),
      lots_((parts_.size() + kLanes - 1) / kLanes),
      own_(parts_.size()),
      articulated_(parts_.size()),
      response_(parts_.size()),
      inverse_(parts_.size()),
      wrench_(parts_.size()),
      along_(parts_.size()),
      drives_(parts_.size()),
      impulse_(parts_.size()) {}

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
      place.axis = parent.R * part.axis;
      place.d = parent.R * part.anchor;
      if (part.kind == Kind::kSlider) place.d += at.way * place.axis;
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
        const double t = 0.5 * h * rate.along, scale = 1 / (1 + t * t);
        const double c = scale * (1 - t * t), s = scale * 2 * t;
        const double cosine = at.cosine * c - at.sine * s, sine = at.sine * c + at.cosine * s;
        at.cosine = cosine, at.sine = sine;
        break;
      }
      case Kind::kSlider:
        at.way += h * rate.along;
        break;
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

void ArticulatedTree::normalize(std::span<Coordinate> coordinates) const {
  for (std::size_t k = 0; k < parts_.size(); ++k)
    if (parts_[k].kind == Kind::kBall || parts_[k].kind == Kind::kFree)
      coordinates[k].q.normalize();
}

ArticulatedTree::Lot ArticulatedTree::gather(std::span<const Place> places,
                                             std::size_t first) const {
  const auto part = [&](int lane) __attribute__((always_inline)) {
    return std::min(first + usize(lane), parts_.size() - 1);
  };
  static_assert(offsetof(Place, x) == sizeof(QuadMatrix));
  const auto pair = [&](int i) __attribute__((always_inline)) {
    return gather_pairs([&](int lane) __attribute__((always_inline)) -> const Quad3& {
      return places[part(lane)].R[i];
    });
  };
  const BodyLanes R01 = pair(0), R2x = pair(2);
  Lot lot;
  lot.R[0] = R01.linear, lot.R[1] = R01.angular, lot.R[2] = R2x.linear;
  lot.x = R2x.angular;
  return lot;
}

void ArticulatedTree::begin(std::span<const Place> from) {
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    const std::size_t first = k * kLanes;
    const auto inertia = load_rows<V>([&](int lane) __attribute__((always_inline)) {
      const std::size_t part = std::min(first + usize(lane), parts_.size() - 1);
      return reinterpret_cast<const Point<double>*>(&parts_[part].inertia);
    });
    lots_[k] = gather(from, first);
    lots_[k].moments[0] = inertia.x, lots_[k].moments[1] = inertia.y;
    lots_[k].moments[2] = inertia.z, lots_[k].mass = inertia.w;
    for (int i = 0; i < 3; ++i) lots_[k].inverse_moments[i] = 1 / lots_[k].moments[i];
    lots_[k].inverse_mass = 1 / inertia.w;
    for (std::size_t lane = 0; lane < kLanes; ++lane)
      lots_[k].counts[lane] = first + lane < parts_.size() ? 1 : 0;
  }
}

double ArticulatedTree::energy(std::span<const Momentum> momenta) const {
  V sum{};
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    const Lot& from = lots_[k];
    const auto at = [&](int lane) __attribute__((always_inline)) -> const Momentum& {
      return momenta[std::min(k * kLanes + usize(lane), parts_.size() - 1)];
    };
    const auto [P, L] = gather_pairs(
        [&](int lane) __attribute__((always_inline)) -> const Quad3& { return at(lane).linear; });
    V of_each = from.inverse_mass * dot(P, P);
    for (int i = 0; i < 3; ++i) {
      const V l = dot(from.R[i], L);
      of_each += from.inverse_moments[i] * (l * l);
    }
    sum += from.counts * of_each;
  }
  return 0.5 * sum_lanes(sum);
}

void ArticulatedTree::find_momenta(std::span<const Place> to, double h,
                                   std::span<Momentum> momenta) const {
  const double rate = 1 / h;
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    const Lot &from = lots_[k], end = gather(to, k * kLanes);
    const Lanes3 f = logarithm(from.R, end.R), way = end.x - from.x;
    const V scale = rate * from.mass;
    Lanes3 body, linear;
    for (int i = 0; i < 3; ++i) {
      body[i] = rate * from.moments[i] * f[i];
      linear[i] = scale * way[i];
    }
    const Lanes3 angular = in_world(from.R, left_momentum(f, body));
    const auto at = [&](int lane) __attribute__((always_inline)) -> Momentum& {
      return momenta[std::min(k * kLanes + usize(lane), parts_.size() - 1)];
    };
    store_bodies({linear, angular}, [&](int lane) __attribute__((always_inline)) {
      return reinterpret_cast<BodyRow*>(&at(lane));
    });
  }
}

void ArticulatedTree::find_turns(std::span<const Place> to, std::span<Quad3> turns) {
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    const Lot end = gather(to, k * kLanes);
    Lot& from = lots_[k];
    scatter_vectors(in_world(from.R, logarithm(from.R, end.R)),
                    [&](int lane) __attribute__((always_inline)) -> Quad3& {
                      return turns[std::min(k * kLanes + usize(lane), parts_.size() - 1)];
                    });
    for (int i = 0; i < 3; ++i) from.R[i] = end.R[i];
    from.x = end.x;
  }
}

void ArticulatedTree::factor(std::span<const Place> from, std::span<const Place> to, double h,
                             std::span<const Momentum> momenta) {
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Part& part = parts_[k];
    const Place &p = from[k], &q = to[k];
    Own& own = own_[k];
    Response& response = response_[k];
    Articulated& all = articulated_[k];
    const double mass = own.mass = part.inertia[3];
    own.c = q.c;
    response.c0 = p.c;
    response.d0 = p.d, response.d1 = q.d;
    response.a0 = p.axis, response.a1 = q.axis;
    QuadMatrix middle;
    for (int i = 0; i < 3; ++i) middle[i] = 0.5 * (p.R[i] + q.R[i]);
    for (int i = 0; i < 3; ++i)
      own.K[i] = part.inertia[0] * middle[0][i] * middle[0] +
                 part.inertia[1] * middle[1][i] * middle[1] +
                 part.inertia[2] * middle[2][i] * middle[2];
    if (!momenta.empty()) own.K = own.K - cross_matrix(0.5 * h * momenta[k].angular);
    all.J =
        part.slow ? p.R * scaled(part.seen_inertia / part.inertia, transpose(p.R) * own.K) : own.K;
    // - m [c0] [c1], m [c0], - m [c1], m
    const Quad3 mc = mass * q.c;
    const double along = dot(p.c, mc);
    for (int i = 0; i < 3; ++i) {
      all.J[i] -= p.c[i] * mc;
      all.J[i][i] += along;
      all.M[i] = Quad3{};
      all.M[i][i] = mass;
    }
    all.H = cross_matrix(mass * p.c);
    all.G = cross_matrix(-mc);
  }
  for (std::size_t k = parts_.size(); k-- > 0;) reduce(k);
}

// What the part's joint leaves of its inertia, to its parent.
void ArticulatedTree::reduce(std::size_t k) {
  const Part& part = parts_[k];
  Response& response = response_[k];
  const Quad3 d0 = response.d0, d1 = response.d1;
  QuadMatrix J = articulated_[k].J, H = articulated_[k].H, G = articulated_[k].G,
             M = articulated_[k].M;
  if (has_coordinate(part.kind)) {
    const bool turns = part.kind == Kind::kHinge;
    const Quad3 a0 = response.a0, a1 = response.a1;
    Quad3 torque, force, turn, shift;
    if (turns) {
      torque = J * a1, force = G * a1;
      turn = transposed_product(J, a0), shift = transposed_product(H, a0);
    } else {
      torque = H * a1, force = M * a1;
      turn = transposed_product(G, a0), shift = transposed_product(M, a0);
    }
    const double D = dot(a0, turns ? torque : force);
    const Drive& drive = drives_[k];
    if (drive.held) {
      response.inverse = D;
      response.force = force;
      response.torque = torque + cross(d0, force);
      response.shift = shift;
      response.turn = turn + cross(d1, shift);
    } else {
      response.inverse = 1 / (D + drive.stiffness);
      const Quad3 by_turn = response.inverse * turn, by_shift = response.inverse * shift;
      J = J - outer(torque, by_turn);
      H = H - outer(torque, by_shift);
      G = G - outer(force, by_turn);
      M = M - outer(force, by_shift);
      response.force = response.inverse * force;
      response.torque = response.inverse * torque + cross(d0, response.force);
      response.shift = by_shift;
      response.turn = by_turn + cross(d1, by_shift);
    }
  } else if (part.kind != Kind::kFixed) {
    Inverse& of = inverse_[k];
    of.J = inverse(J);
    of.JH = of.J * H;
    of.GJ = G * of.J;
    M = M - G * of.JH;
    if (part.kind == Kind::kFree) {
      of.M = inverse(M);
      return;
    }
    J = H = G = {};
  }
  if (part.parent < 0) return;
  // With H' = H + [d0] M at the parent's anchor: J - H' [d1] + [d0] G, H', G - M [d1], M.
  Articulated& parent = articulated_[usize(part.parent)];
  H = H + cross(d0, M);
  parent.J = parent.J + (J + cross(d0, G) - cross(H, d1));
  parent.H = parent.H + H;
  parent.G = parent.G + (G - cross(M, d1));
  parent.M = parent.M + M;
}

void ArticulatedTree::respond(std::span<const Momentum> momenta, std::span<Rate> rates) {
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Momentum& m = momenta[k];
    wrench_[k] = {m.linear, m.angular + cross(response_[k].c0, m.linear)};
  }
  for (std::size_t k = parts_.size(); k-- > 0;) {
    const Part& part = parts_[k];
    const Response& own = response_[k];
    const Quad3 force = wrench_[k].linear, torque = wrench_[k].angular;
    if (has_coordinate(part.kind)) {
      const Drive& drive = drives_[k];
      Quad3 along = dot_lanes(own.a0, part.kind == Kind::kHinge ? torque : force);
      if (drive.held) {
        impulse_[k] = own.inverse * drive.change - along[0];
        along = Quad3{} + drive.change;
      } else {
        along += drive.impulse;
        along_[k] = along[0] * own.inverse;
      }
      if (part.parent < 0) continue;
      Momentum& parent = wrench_[usize(part.parent)];
      parent.linear = (parent.linear + force) - along * own.force;
      parent.angular = (parent.angular + torque + cross(own.d0, force)) - along * own.torque;
    } else if (part.kind == Kind::kFixed) {
      if (part.parent < 0) continue;
      Momentum& parent = wrench_[usize(part.parent)];
      parent.linear += force;
      parent.angular += torque + cross(own.d0, force);
    } else {
      const Quad3 left = wrench_[k].linear = force - inverse_[k].GJ * torque;
      if (part.parent < 0) continue;
      Momentum& parent = wrench_[usize(part.parent)];
      parent.linear += left;
      parent.angular += cross(own.d0, left);
    }
  }
  const Rate rest;
  for (std::size_t k = 0; k < parts_.size(); ++k) {
    const Part& part = parts_[k];
    const Response& own = response_[k];
    Rate& rate = rates[k];
    if (part.kind == Kind::kFree) {
      rate.linear = inverse_[k].M * wrench_[k].linear;
      rate.angular = inverse_[k].J * wrench_[k].angular - inverse_[k].JH * rate.linear;
      continue;
    }
    const Rate& parent = part.parent < 0 ? rest : rates[usize(part.parent)];
    rate.linear = parent.linear - cross(own.d1, parent.angular);
    if (has_coordinate(part.kind)) {
      const Quad3 carried =
          dot_lanes(own.turn, parent.angular) + dot_lanes(own.shift, parent.linear);
      const Drive& drive = drives_[k];
      rate.along = drive.held ? drive.change : along_[k] - carried[0];
      impulse_[k] =
          drive.held ? impulse_[k] + carried[0] : drive.impulse - drive.stiffness * rate.along;
      rate.angular = parent.angular;
      Quad3& moved = part.kind == Kind::kHinge ? rate.angular : rate.linear;
      moved += rate.along * own.a1;
    } else if (part.kind == Kind::kBall) {
      rate.angular = inverse_[k].J * wrench_[k].angular - inverse_[k].JH * rate.linear;
    } else {
      rate.angular = parent.angular;
    }
  }
}

}  // namespace substep::rigid
