#include "substep/rigid/solver/impacts.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"

namespace substep::rigid {
namespace {

constexpr int kBlockSweeps = 64;                // of the impulses of one manifold, at most
constexpr std::int64_t kEventsPerContact = 32;  // in one sub-step, on the average, at most
constexpr double kFast = 1e-3;    // least way in a sub-step of what meets fast, of its size
constexpr int kNewton = 16;       // steps towards the time at which what rolls meets
constexpr double kMeets = 1e-13;  // how near that is [m]

double reach(const ContactConstraint& c) {
  return std::min(c.points[0].arm_a.norm(), c.points[0].arm_b.norm());
}

}  // namespace

void Impacts::set(const ContactConstraint& c, const BodyRows& rows, Row& row) {
  row.count = c.count;
  row.normal = c.normal, row.tangent[0] = c.tangent, row.tangent[1] = c.normal.cross(c.tangent);
  const Mat3 A = rows.root_of(row.a), B = rows.root_of(row.b);
  const auto gradient = [&](const Vec3& arm_a, const Vec3& arm_b, const Vec3& direction) {
    return Gradient{A * arm_a.cross(direction), B * arm_b.cross(direction)};
  };
  for (int k = 0; k < c.count; ++k) {
    row.separation[k] = c.points[k].separation;
    row.points[k] = gradient(c.points[k].arm_a, c.points[k].arm_b, c.normal);
  }
  const Vec3 middle_a = c.middle(&ContactConstraint::Point::arm_a),
             middle_b = c.middle(&ContactConstraint::Point::arm_b);
  for (int i = 0; i < 2; ++i) row.slide[i] = gradient(middle_a, middle_b, row.tangent[i]);
  const double linear =
      (row.moves_a ? row.scale_a * row.scale_a : 0) + (row.moves_b ? row.scale_b * row.scale_b : 0);
  for (int k = 0; k < c.count; ++k) {
    for (int l = 0; l < c.count; ++l) {
      row.block[k][l] = linear +
                        (row.moves_a ? row.points[k].angular_a.dot(row.points[l].angular_a) : 0) +
                        (row.moves_b ? row.points[k].angular_b.dot(row.points[l].angular_b) : 0);
    }
  }
}

void Impacts::begin_step(std::span<const ContactConstraint> contacts,
                         std::span<const std::uint8_t> rolling, double h, const BodyRows& rows,
                         const Find& find) {
  contacts_.clear();
  happened_ = 0;
  find_ = find;
  for (std::size_t index = 0; index < contacts.size(); ++index) {
    const ContactConstraint& c = contacts[index];
    const bool rolls = rolling[index] != 0 && c.rolls_on;
    if (c.count == 0 || !(c.restitution > 0 || rolls)) continue;
    Row row{};
    row.index = static_cast<std::int32_t>(index);
    row.a = rows.row(c.a), row.b = rows.row(c.b);
    row.moves_a = rows.moves(row.a), row.moves_b = rows.moves(row.b);
    if (!row.moves_a && !row.moves_b) continue;
    row.rolls = rolls;
    row.scale_a = rows.scale_of(row.a), row.scale_b = rows.scale_of(row.b);
    row.restitution = c.restitution, row.friction = c.friction;
    set(c, rows, row);
    if (!(c.restitution > 0)) {
      const double u = along(row, row.normal, row.points[0], rows.velocity);
      if (!(c.points[0].separation > 0 && -h * u > kFast * reach(c))) continue;
    }
    contacts_.push_back(row);
  }
  if (contacts_.empty()) return;
  of_body_.assign(rows.size(), [&](const auto& visit) {
    for (std::size_t k = 0; k < contacts_.size(); ++k) {
      if (contacts_[k].moves_a) visit(contacts_[k].a, static_cast<std::int32_t>(k));
      if (contacts_[k].moves_b) visit(contacts_[k].b, static_cast<std::int32_t>(k));
    }
  });
}

void Impacts::renew(std::span<const ContactConstraint> contacts, const BodyRows& rows) {
  for (Row& row : contacts_) {
    if (!row.rolls) continue;
    row.contact = contacts[usize(row.index)];
    set(row.contact, rows, row);
    for (int k = 0; k < row.count; ++k)
      row.separation[k] -= along(row, row.normal, row.points[k], rows.displacement);
  }
}

// The row as it is when its shapes meet, from the time on at which their planes do; false if they
// pass by each other in this sub-step. Where Newton's method does not find the time, as of what
// turns far meanwhile, the planes say.
bool Impacts::meet(Row& row, const BodyRows& rows, double h, double& time) const {
  const double g = acceleration(row, rows, h), planes_meet = time;
  const Row planes = row;
  // What is farther apart at any time of the sub-step does not meet in it. Impacts before may have
  // made it faster than it was.
  const auto& point = row.contact.points[0];
  const double fast = (rows.velocity_of(row.b) - rows.velocity_of(row.a)).norm() +
                      rows.spin_of(row.a).norm() * point.arm_a.norm() +
                      rows.spin_of(row.b).norm() * point.arm_b.norm();
  row.contact.margin = std::max(row.contact.margin, h * fast);
  for (int k = 0; k < kNewton; ++k) {
    ContactConstraint c = row.contact;
    if (!find_(c, time)) return false;
    if (c.count > 1) break;
    set(c, rows, row);
    const auto nearest = std::min_element(row.separation, row.separation + row.count);
    const double C = *nearest + 0.5 * g * time * time;  // find_ follows lines
    const double u =
        along(row, row.normal, row.points[nearest - row.separation], rows.velocity) + g * time;
    for (int i = 0; i < row.count; ++i) {
      row.separation[i] -= along(row, row.normal, row.points[i], rows.displacement) +
                           time * along(row, row.normal, row.points[i], rows.velocity);
    }
    if (!(u < 0)) return false;
    if (std::abs(C) < kMeets) return true;
    time = std::max(time - C / u, 0.);
    if (time > h) return false;
  }
  row = planes, time = planes_meet;
  return true;
}

// gradient . (linear, angular)
double Impacts::along(const Row& row, const Vec3& direction, const Gradient& gradient,
                      const BodyRows::Rows& rows) const {
  const BodyRow &a = rows[usize(row.a)], &b = rows[usize(row.b)];
  return direction.dot(row.scale_b * from_row(b.linear) - row.scale_a * from_row(a.linear)) +
         (gradient.angular_b.dot(from_row(b.angular)) -
          gradient.angular_a.dot(from_row(a.angular)));
}

double Impacts::acceleration(const Row& row, const BodyRows& rows, double h) const {
  const auto of = [&](std::int32_t i) {
    return Vec3(from_row(rows.acceleration[usize(i)].linear) +
                from_row(rows.push[usize(i)].linear) / h);
  };
  return row.normal.dot(row.scale_b * of(row.b) - row.scale_a * of(row.a));
}

Impacts::Fate Impacts::fate(const Row& row, const BodyRows& rows, double h, double& time) const {
  const double g = acceleration(row, rows, h);
  Fate fate = Fate::kResting;
  time = h;
  for (int k = 0; k < row.count; ++k) {
    const double C =
        std::max(row.separation[k] + along(row, row.normal, row.points[k], rows.displacement), 0.0);
    const double u = along(row, row.normal, row.points[k], rows.velocity);
    const double square = u * u - 2 * g * C;
    if (!(square > 0) || (u >= 0 && (g >= 0 || C == 0))) continue;
    const double speed = std::sqrt(square);
    if (speed <= 2 * std::abs(g) * h + 1e-9) continue;
    const double t = C == 0 ? 0 : 2 * C / (speed - u);
    if (t > h) {
      if (fate == Fate::kResting) fate = Fate::kFlying;
      continue;
    }
    time = std::min(time, t);
    fate = Fate::kImpact;
  }
  return fate;
}

// A contact that carries weight stays one, even if one of its points bounces.
bool Impacts::rests(const Row& row, const BodyRows& rows, double h, double slop) const {
  const double g = std::abs(acceleration(row, rows, h));
  for (int k = 0; k < row.count; ++k) {
    const double C = row.separation[k] + along(row, row.normal, row.points[k], rows.displacement);
    const double u = along(row, row.normal, row.points[k], rows.velocity);
    if (C <= slop && std::abs(u) <= 2 * g * h + 1e-9) return true;
  }
  return false;
}

void Impacts::collide(Row& row, BodyRows& rows, double h, double time) const {
  const double g = acceleration(row, rows, h);
  double before[4], l[4] = {};
  bool meets[4];
  for (int k = 0; k < row.count; ++k) {
    const double C = row.separation[k] + along(row, row.normal, row.points[k], rows.displacement);
    before[k] = along(row, row.normal, row.points[k], rows.velocity) + g * time;
    meets[k] = C <= 0 || C + before[k] * h <= 0;
  }
  for (int sweep = 0; sweep < kBlockSweeps; ++sweep) {
    double change = 0, most = 0;
    for (int k = 0; k < row.count; ++k) {
      if (!meets[k]) continue;
      double residual = (1 + row.restitution) * before[k];
      for (int j = 0; j < row.count; ++j) residual += row.block[k][j] * l[j];
      const double next = std::max(0.0, l[k] - residual / row.block[k][k]);
      change = std::max(change, std::abs(next - l[k]));
      most = std::max(most, l[k] = next);
    }
    if (change <= 1e-15 * most) break;
  }
  const Vec3 va = from_row(rows.velocity[usize(row.a)].linear),
             wa = from_row(rows.velocity[usize(row.a)].angular),
             vb = from_row(rows.velocity[usize(row.b)].linear),
             wb = from_row(rows.velocity[usize(row.b)].angular);
  const auto apply = [&](const Vec3& direction, const Gradient& gradient, double impulse) {
    if (row.moves_a) {
      add(rows.velocity[usize(row.a)].linear, -impulse * row.scale_a * direction);
      add(rows.velocity[usize(row.a)].angular, -impulse * gradient.angular_a);
    }
    if (row.moves_b) {
      add(rows.velocity[usize(row.b)].linear, impulse * row.scale_b * direction);
      add(rows.velocity[usize(row.b)].angular, impulse * gradient.angular_b);
    }
  };
  double pressure = 0;
  for (int k = 0; k < row.count; ++k) {
    apply(row.normal, row.points[k], l[k]);
    row.given[k] += l[k];
    pressure += l[k];
  }
  if (row.friction > 0 && pressure > 0) {
    Eigen::Matrix2d mobility;
    Eigen::Vector2d slip;
    for (int i = 0; i < 2; ++i) {
      slip[i] = along(row, row.tangent[i], row.slide[i], rows.velocity);
      for (int j = 0; j < 2; ++j) {
        const auto part = [&](bool moves, double scale, const Vec3& p, const Vec3& q) {
          return moves ? (i == j ? scale * scale : 0) + p.dot(q) : 0;
        };
        mobility(i, j) =
            part(row.moves_a, row.scale_a, row.slide[i].angular_a, row.slide[j].angular_a) +
            part(row.moves_b, row.scale_b, row.slide[i].angular_b, row.slide[j].angular_b);
      }
    }
    Eigen::Vector2d impulse = -(mobility.inverse() * slip);
    const double limit = row.friction * pressure, length = impulse.norm();
    if (length > limit) impulse *= limit / length;
    for (int i = 0; i < 2; ++i) {
      apply(row.tangent[i], row.slide[i], impulse[i]);
      row.friction_given[i] += impulse[i];
    }
  }
  const auto shift = [&](std::int32_t i, const Vec3& v, const Vec3& w) {
    const BodyRow& now = rows.velocity[usize(i)];
    add(rows.displacement[usize(i)].linear, -time * (from_row(now.linear) - v));
    add(rows.displacement[usize(i)].angular, -time * (from_row(now.angular) - w));
  };
  if (row.moves_a) shift(row.a, va, wa);
  if (row.moves_b) shift(row.b, vb, wb);
}

void Impacts::advance(BodyRows& rows, double h, double slop) {
  flying_.assign(contacts_.size(), 0);
  queue_.clear();
  double time = 0;
  const auto push = [&](std::int32_t k) {
    if (fate(contacts_[usize(k)], rows, h, time) != Fate::kImpact) return;
    queue_.push_back({time, k});
    std::push_heap(queue_.begin(), queue_.end(), std::greater<>());
  };
  for (std::int32_t k = 0; k < static_cast<std::int32_t>(contacts_.size()); ++k) push(k);
  std::int64_t left = kEventsPerContact * count();
  while (!queue_.empty() && left-- > 0) {
    std::pop_heap(queue_.begin(), queue_.end(), std::greater<>());
    const Event event = queue_.back();
    queue_.pop_back();
    Row& row = contacts_[usize(event.row)];
    const bool impact = fate(row, rows, h, time) == Fate::kImpact;
    if (!impact || time != event.time) continue;  // another impact changed it, and pushed it anew
    if (row.rolls && !meet(row, rows, h, time)) continue;
    collide(row, rows, h, time);
    flying_[usize(event.row)] = 1;
    ++happened_;
    for (const auto& [body, moves] : {std::pair(row.a, row.moves_a), {row.b, row.moves_b}}) {
      if (!moves) continue;
      for (const std::int32_t k : of_body_.of(body)) push(k);
    }
  }
  for (std::size_t k = 0; k < contacts_.size(); ++k) {
    const Row& row = contacts_[k];
    const bool flies = flying_[k] != 0 || fate(row, rows, h, time) == Fate::kFlying;
    flying_[k] = flies && !rests(row, rows, h, slop);
  }
}

void Impacts::report(std::span<ContactConstraint> contacts) const {
  for (const Row& row : contacts_) {
    ContactConstraint& contact = contacts[usize(row.index)];
    for (int k = 0; k < 4; ++k) contact.last_of(k).total += row.given[k];
    for (int i = 0; i < 2; ++i) contact.friction_total[i] += row.friction_given[i];
  }
}

}  // namespace substep::rigid
