#include "substep/rigid/solver/impact_start.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/point_lanes.h"
#include "substep/core/usize.h"
#include "substep/rigid/solver/islands.h"

namespace substep::rigid {
namespace {

// Of the impulses, what is of an impact: from 0 to 1.
ImpactStart::V part_of_impact(const ContactPacket& packet, const ImpactStart::V& load) {
  const ImpactStart::V all = packet.pressure();
  return all > load ? 1 - load / (all > load ? all : splat<ImpactStart::V>(1)) : ImpactStart::V{};
}

template <class Quad>
double sum(const Quad& x) {
  return (x[0] + x[1]) + x[2];
}

}  // namespace

void ImpactStart::begin_step(std::span<const Joint> joints, const BodyRows& rows) {
  const auto n = rows.size();
  excess_.reset(usize(n));
  std::fill(excess_.begin(), excess_.end(), BodyRow{});
  label_.resize(usize(n));
  constexpr double kInfinite = std::numeric_limits<double>::infinity();
  rows_.assign(usize(n), {.jump = kInfinite, .growth = kInfinite});
  for (std::int32_t i = 0; i < n; ++i) {
    if (!rows.moves(i)) continue;
    const double mass = 1 / (rows.scale_of(i) * rows.scale_of(i));
    rows_[usize(i)].jump = kJump * mass;
    rows_[usize(i)].growth = mass;
  }
  pairs_.clear();
  hit_.clear();
  for (const Joint& joint : joints) {
    const std::int32_t a = rows.row(joint.a), b = rows.row(joint.b);
    add_row(a), add_row(b);
    rows_[usize(a)].jointed = rows_[usize(b)].jointed = true;
    if (rows.moves(a) && rows.moves(b)) pairs_.push_back({a, b});
  }
  joined_ = pairs_, jointed_ = hit_;
  if (joined_.empty()) return;
  label_islands(pairs_, label_);
  std::vector<double> whole(usize(n), 0);
  for (std::size_t i = 1; i < usize(n); ++i) whole[usize(label_[i])] += rows_[i].growth;
  for (std::size_t i = 1; i < usize(n); ++i) {
    if (!rows.moves(static_cast<std::int32_t>(i))) continue;
    Row& row = rows_[i];
    row.jump = std::max(row.jump, whole[usize(label_[i])]);
    row.growth = std::sqrt(row.growth * whole[usize(label_[i])]);
  }
}

void ImpactStart::add_row(std::int32_t row) {
  if (row == 0 || rows_[usize(row)].hit) return;
  rows_[usize(row)].hit = true;
  hit_.push_back(row);
}

void ImpactStart::begin(bool with_joints) {
  with_joints_ = with_joints;
  for (const std::int32_t i : hit_) {
    Row& row = rows_[usize(i)];
    row.hit = false, row.along = row.square = row.power = 0;
  }
  pairs_.clear(), hit_.clear();
  if (!with_joints) return;
  pairs_ = joined_;
  for (const std::int32_t i : jointed_) add_row(i);
}

void ImpactStart::add(const ContactPacket& packet, int lane, double part, const BodyRows& rows) {
  const std::int32_t a = packet.a[lane], b = packet.b[lane];
  V parts{};
  parts[lane] = part;
  packet.push(parts, excess_);
  add_row(a), add_row(b);
  if (packet.kinematic)
    rows_[row_of(packet, lane)].power += part * packet.power_of_unmoved(rows)[lane];
  if (packet.moves_a[lane] && packet.moves_b[lane]) pairs_.push_back({a, b});
}

void ImpactStart::add(const ContactPacket& packet, const V& load, const BodyRows& rows) {
  const V part = part_of_impact(packet, load);
  packet.push(part, excess_);
  V power = -packet.braking(rows);
  if (packet.kinematic) power = power + packet.power_of_unmoved(rows);
  power = part * power;
  for (int lane = 0; lane < ContactPacket::kLanes; ++lane) {
    if (!(part[lane] > 0)) continue;
    const std::int32_t a = packet.a[lane], b = packet.b[lane];
    add_row(a), add_row(b);
    rows_[row_of(packet, lane)].power += power[lane];
    if (packet.moves_a[lane] && packet.moves_b[lane]) pairs_.push_back({a, b});
  }
}

void ImpactStart::withdraw(BodyRows& rows) {
  label_islands(pairs_, label_);
  const auto each = [&](const auto& task) {
    for (const std::int32_t i : hit_) task(usize(i), rows.velocity[usize(i)]);
  };
  each([&](std::size_t i, const BodyRow& v) {
    const BodyRow& e = with_joints_ && rows_[i].jointed ? rows.push[i] : excess_[i];
    const auto x = load_quad(e.linear), w = load_quad(e.angular);
    Row& all = rows_[usize(label_[i])];
    all.along += sum(load_quad(v.linear) * x + load_quad(v.angular) * w) + rows_[i].power;
    all.square += sum(x * x + w * w);
  });
  each([&](std::size_t i, const BodyRow&) {
    if (usize(label_[i]) != i) return;
    Row& all = rows_[i];
    all.withdrawn = all.square > 0 ? std::clamp(all.along / all.square, 0., 1.) : 0;
  });
  each([&](std::size_t i, BodyRow& v) {
    const double s = withdrawn(i);
    BodyRow& e = excess_[i];
    store_quad(v.linear, load_quad(v.linear) - s * load_quad(e.linear));
    store_quad(v.angular, load_quad(v.angular) - s * load_quad(e.angular));
    e = {};
  });
}

ImpactStart::V ImpactStart::left(const ContactPacket& packet, const V& load) const {
  V part = part_of_impact(packet, load);
  for (int lane = 0; lane < ContactPacket::kLanes; ++lane) {
    if (!(part[lane] > 0)) continue;
    part[lane] *= withdrawn(row_of(packet, lane));
  }
  return 1 - part;
}

}  // namespace substep::rigid
