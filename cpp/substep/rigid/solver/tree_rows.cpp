#include "substep/rigid/solver/tree_rows.h"

#include <algorithm>

#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

using V = LanesOfBodies;
using V3 = Vector3<V>;

// A v, of columns.
SUBSTEP_INLINE V3 product(const V3 (&A)[3], const V3& v) {
  return v[0] * A[0] + v[1] * A[1] + v[2] * A[2];
}
SUBSTEP_INLINE V3 transposed_product(const V3 (&A)[3], const V3& v) {
  return {{dot(A[0], v), dot(A[1], v), dot(A[2], v)}};
}
SUBSTEP_INLINE BodyLanes operator+(const BodyLanes& a, const BodyLanes& b) {
  return {a.linear + b.linear, a.angular + b.angular};
}
SUBSTEP_INLINE BodyLanes operator-(const BodyLanes& a, const BodyLanes& b) {
  return {a.linear - b.linear, a.angular - b.angular};
}
SUBSTEP_INLINE auto differs(const V3& a, const V3& b) {
  return (a[0] != b[0]) | (a[1] != b[1]) | (a[2] != b[2]);
}
SUBSTEP_INLINE auto differs(const BodyLanes& a, const BodyLanes& b) {
  return differs(a.linear, b.linear) | differs(a.angular, b.angular);
}
template <class Mask>
SUBSTEP_INLINE V3 select(const Mask& mask, const V3& a, const V3& b) {
  V3 c;
  for (int i = 0; i < 3; ++i) c[i] = mask ? a[i] : b[i];
  return c;
}
void put(V3& v, int lane, const Quad3& value) {
  for (int i = 0; i < 3; ++i) v[i][lane] = value[i];
}

}  // namespace

TreeRows::TreeRows(std::size_t bodies) : bodies_(bodies), lots_((bodies + kLanes - 1) / kLanes) {}

template <class Call>
void TreeRows::for_lanes(std::size_t b, const Call& call) {
  Lot& lot = lots_[b / kLanes];
  const auto lane = static_cast<int>(b % kLanes);
  for (int k = lane; k < (b + 1 == bodies_ ? kLanes : lane + 1); ++k) call(lot, k);
}

SUBSTEP_INLINE std::size_t TreeRows::body(std::size_t lot, int lane) const {
  return std::min(lot * kLanes + usize(lane), bodies_ - 1);
}

SUBSTEP_INLINE BodyLanes TreeRows::load(const Lot& lot, const BodyRows::Rows& rows) const {
  return load_bodies([&](int lane)
                         __attribute__((always_inline)) { return &rows[usize(lot.row[lane])]; });
}
SUBSTEP_INLINE void TreeRows::store(const BodyLanes& lanes, const Lot& lot,
                                    BodyRows::Rows& rows) const {
  store_bodies(
      lanes, [&](int lane) __attribute__((always_inline)) { return &rows[usize(lot.row[lane])]; });
}
// A momentum is six numbers as a row has them.
SUBSTEP_INLINE BodyLanes TreeRows::gather(std::span<const Tree::Momentum> momenta,
                                          std::size_t lot) const {
  static_assert(sizeof(Tree::Momentum) == sizeof(BodyRow));
  return load_bodies([&](int lane) __attribute__((always_inline)) {
    return reinterpret_cast<const BodyRow*>(&momenta[body(lot, lane)]);
  });
}
SUBSTEP_INLINE void TreeRows::scatter(const BodyLanes& lanes, std::size_t lot,
                                      std::span<Tree::Momentum> momenta) const {
  store_bodies(lanes, [&](int lane) __attribute__((always_inline)) {
    return reinterpret_cast<BodyRow*>(&momenta[body(lot, lane)]);
  });
}

// W^(-1/2) w of an angular momentum.
SUBSTEP_INLINE TreeRows::V3 TreeRows::spin(const Tree& tree, std::size_t lot, const V3& L) const {
  const Tree::Lot& at = tree.lots()[lot];
  V3 w = transposed_product(at.R, L);
  for (int i = 0; i < 3; ++i) w[i] = at.inverse_moments[i] * w[i];
  return product(lots_[lot].unroot, product(at.R, w));
}

void TreeRows::set(std::size_t b, std::int32_t row, const BodyRows& rows, const Quad3& position,
                   const QuadMatrix& unroot) {
  const QuadMatrix root = QuadMatrix::of(rows.root_of(row));
  for_lanes(b, [&](Lot& lot, int lane) {
    lot.row[lane] = row;
    lot.scale[lane] = rows.scale_of(row);
    put(lot.origin, lane, position);
    for (int i = 0; i < 3; ++i) {
      put(lot.root[i], lane, root[i]);
      put(lot.unroot[i], lane, unroot[i]);
    }
  });
}

void TreeRows::begin_step(const Tree& tree, std::span<Tree::Momentum> momenta, BodyRows& rows) {
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    Lot& lot = lots_[k];
    lot.from_joints = lot.seen_displaced = lot.given = {};
    BodyLanes m = gather(momenta, k);
    lot.seen = load(lot, rows.velocity);
    m.linear = (1 / lot.scale) * lot.seen.linear;
    scatter(m, k, momenta);
  }
  show_spins(tree, momenta, rows);
}

void TreeRows::kick(double time, const BodyRows& rows, std::span<Tree::Momentum> momenta) const {
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    const Lot& lot = lots_[k];
    BodyLanes m = gather(momenta, k);
    const BodyLanes a = load(lot, rows.acceleration);
    m.linear = m.linear + (time / lot.scale) * a.linear;
    m.angular = m.angular + splat<V>(time) * product(lot.unroot, a.angular);
    scatter(m, k, momenta);
  }
}

bool TreeRows::read(const BodyRows& rows, std::span<Tree::Momentum> momenta) {
  bool any_changed = false;
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    Lot& lot = lots_[k];
    const BodyLanes v = load(lot, rows.velocity);
    const auto changed = differs(v, lot.seen);
    if (!any(changed)) continue;
    any_changed = true;
    BodyLanes m = gather(momenta, k);
    const V3 L = m.angular + product(lot.unroot, v.angular - lot.seen.angular);
    m.linear = select(changed, (1 / lot.scale) * v.linear, m.linear);
    m.angular = select(changed, L, m.angular);
    scatter(m, k, momenta);
    lot.seen = v;
  }
  return any_changed;
}

void TreeRows::show_spins(const Tree& tree, std::span<const Tree::Momentum> momenta,
                          BodyRows& rows) {
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    Lot& lot = lots_[k];
    lot.seen.angular = spin(tree, k, gather(momenta, k).angular);
    store(lot.seen, lot, rows.velocity);
  }
}

void TreeRows::show(const Tree& tree, std::span<const Tree::Momentum> momenta, BodyRows& rows) {
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    Lot& lot = lots_[k];
    const BodyLanes m = gather(momenta, k);
    lot.seen = {lot.scale * m.linear, spin(tree, k, m.angular)};
    store(lot.seen, lot, rows.velocity);
  }
}

void TreeRows::give(const Tree& tree, std::span<const Tree::Momentum> momenta, BodyRows& rows) {
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    Lot& lot = lots_[k];
    const BodyLanes m = gather(momenta, k), before = lot.seen;
    lot.seen = lot.from_joints = {lot.scale * m.linear, spin(tree, k, m.angular)};
    store(lot.seen, lot, rows.velocity);
    lot.given = lot.given + (lot.seen - before);
  }
}

void TreeRows::give_spin(const Tree& tree, std::size_t b, std::span<const Tree::Momentum> momenta,
                         BodyRows& rows) {
  const std::size_t k = b / kLanes;
  const V3 w = spin(tree, k, gather(momenta, k).angular);
  for_lanes(b, [&](Lot& lot, int lane) {
    for (int i = 0; i < 3; ++i) {
      lot.given.angular[i][lane] += w[i][lane] - lot.seen.angular[i][lane];
      lot.seen.angular[i][lane] = w[i][lane];
    }
  });
  store(lots_[k].seen, lots_[k], rows.velocity);
}

void TreeRows::withdraw(BodyRows& rows) {
  for (Lot& lot : lots_) {
    store(load(lot, rows.velocity) - lot.given, lot, rows.velocity);
    lot.given = {};
  }
}

bool TreeRows::find_displacements(const BodyRows& rows, double h,
                                  std::span<Tree::Momentum> aside) const {
  bool found = false;
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    const Lot& lot = lots_[k];
    const V time = splat<V>(h);
    const BodyLanes x = load(lot, rows.displacement) - lot.seen_displaced;
    const BodyLanes d{lot.scale * (x.linear - time * lot.from_joints.linear),
                      product(lot.root, x.angular - time * lot.from_joints.angular)};
    found = found || any(differs(d, BodyLanes{}));
    scatter(d, k, aside);
  }
  return found;
}

bool TreeRows::find_drifts(const BodyRows& rows, double h, std::span<Tree::Momentum> aside) const {
  bool found = false;
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    const Lot& lot = lots_[k];
    const BodyLanes v = load(lot, rows.velocity) - lot.from_joints;
    const BodyLanes d{(h * lot.scale) * v.linear, splat<V>(h) * product(lot.root, v.angular)};
    found = found || any(differs(d, BodyLanes{}));
    scatter(d, k, aside);
  }
  return found;
}

void TreeRows::show_places(std::span<const Tree::Place> places, std::span<const Quad3> turns,
                           BodyRows& rows) {
  const auto vectors = [&](std::size_t k, const auto& at) __attribute__((always_inline)) {
    const auto p = load_rows<V>([&](int lane) __attribute__((always_inline)) {
      return reinterpret_cast<const Point<double>*>(&at(body(k, lane)));
    });
    return V3{{p.x, p.y, p.z}};
  };
  for (std::size_t k = 0; k < lots_.size(); ++k) {
    Lot& lot = lots_[k];
    const V3 x = vectors(k, [&](std::size_t b) -> const Quad3& { return places[b].x; });
    const V3 turn = vectors(k, [&](std::size_t b) -> const Quad3& { return turns[b]; });
    BodyLanes& seen = lot.seen_displaced;
    seen.linear = (1 / lot.scale) * (x - lot.origin);
    seen.angular = seen.angular + product(lot.unroot, turn);
    store(seen, lot, rows.displacement);
  }
}

void TreeRows::end_step(std::span<const Tree::Place> places, BodyRows& rows) const {
  for (std::size_t b = 0; b < bodies_; ++b) {
    const Lot& lot = lots_[b / kLanes];
    const auto lane = b % kLanes;
    BodyRow& x = rows.displacement[usize(lot.row[lane])];
    x = {};
    const double scale = 1 / lot.scale[lane];
    x.linear.x = scale * (places[b].x[0] - lot.origin[0][lane]);
    x.linear.y = scale * (places[b].x[1] - lot.origin[1][lane]);
    x.linear.z = scale * (places[b].x[2] - lot.origin[2][lane]);
  }
}

}  // namespace substep::rigid
