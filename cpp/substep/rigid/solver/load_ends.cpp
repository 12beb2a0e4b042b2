#include "substep/rigid/solver/load_ends.h"

#include <algorithm>

#include "substep/core/point_lanes.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr int kLanes = ContactPacket::kLanes;

double dot(const BodyRow& x, const BodyRow& y) {
  const auto xy =
      load_quad(x.linear) * load_quad(y.linear) + load_quad(x.angular) * load_quad(y.angular);
  return (xy[0] + xy[1]) + xy[2];
}

void add(double s, const BodyRow& x, BodyRow& sum) {
  store_quad(sum.linear, load_quad(sum.linear) + s * load_quad(x.linear));
  store_quad(sum.angular, load_quad(sum.angular) + s * load_quad(x.angular));
}

template <class Quad>
double square(const Quad& x) {
  return (x[0] * x[0] + x[1] * x[1]) + x[2] * x[2];
}

}  // namespace

// What is left of that of its velocity in this sub-step.
BodyRow LoadEnds::change(const BodyRows& rows, std::size_t row, double h) const {
  BodyRow d = rows.velocity[row];
  add(-1, rows.free[row], d);
  add(h, rows.acceleration[row], d);
  add(-1, lost_[row], d);
  return d;
}

std::span<const LoadEnds::Part> LoadEnds::find(const BodyRows& rows,
                                               std::span<const ContactPacket> packets,
                                               const Bears& bears,
                                               std::span<const std::uint8_t> jointed, double h,
                                               double fast) {
  parts_.clear();
  thrown_.clear();
  const auto is_thrown = [&](std::size_t row, const auto& linear) {
    const double scale = rows.root[row].linear.w, much = kMuch * fast;
    return square(linear) * scale * scale > much * much;
  };
  for (std::size_t i = 1; i < usize(rows.size()); ++i) {
    const auto d = load_quad(rows.velocity[i].linear) - load_quad(rows.free[i].linear) +
                   h * load_quad(rows.acceleration[i].linear);
    const auto row = static_cast<std::int32_t>(i);
    if (is_thrown(i, d) && rows.moves(row) && jointed[i] == 0) thrown_.push_back(row);
  }
  if (thrown_.empty()) return parts_;
  lost_.assign(usize(rows.size()), BodyRow{});
  contacts_of_.assign(rows.size(), [&](const auto& visit) {
    std::int32_t place = 0;
    for (const ContactPacket& packet : packets) {
      for (int lane = 0; lane < kLanes; ++lane, ++place) {
        if (packet.moves_a[lane]) visit(packet.a[lane], place);
        if (packet.moves_b[lane]) visit(packet.b[lane], place);
      }
    }
  });
  left_.assign(packets.size() * kLanes, 1);
  times_.assign(usize(rows.size()), 0);
  for (std::size_t next = 0; next < thrown_.size(); ++next) {
    const std::int32_t row = thrown_[next];
    const auto i = usize(row);
    const BodyRow d = change(rows, i, h);
    if (!is_thrown(i, load_quad(d.linear))) continue;
    BodyRow e{};
    pushes_.clear();
    for (const std::int32_t place : contacts_of_.of(row)) {
      const ContactPacket& packet = packets[usize(place / kLanes)];
      const int lane = place % kLanes;
      if (!(left_[usize(place)] > 0) || !bears(place / kLanes, lane)) continue;
      const BodyRow push = packet.impulse_on(lane, packet.b[lane] == row);
      if (!(dot(d, push) > 0)) continue;
      pushes_.push_back({place, push});
      add(left_[usize(place)], push, e);
    }
    if (pushes_.empty()) continue;
    pass_on(row, std::min(1., dot(d, e) / dot(e, e)), packets, jointed);
  }
  for (Part& part : parts_) part.part = 1 - left_[usize(part.packet * kLanes + part.lane)];
  return parts_;
}

// This part of the pushes on the row is not left.
void LoadEnds::pass_on(std::int32_t row, double part, std::span<const ContactPacket> packets,
                       std::span<const std::uint8_t> jointed) {
  for (const Push& push : pushes_) {
    const ContactPacket& packet = packets[usize(push.place / kLanes)];
    const int lane = push.place % kLanes;
    double& left = left_[usize(push.place)];
    if (left == 1) parts_.push_back({push.place / kLanes, lane, 0});
    const double lost = part * left;
    left = std::max(0., left - lost);
    add(lost, push.impulse, lost_[usize(row)]);
    const bool is_b = packet.b[lane] == row;
    if (!(is_b ? packet.moves_a : packet.moves_b)[lane]) continue;
    const std::int32_t other = (is_b ? packet.a : packet.b)[lane];
    add(lost, packet.impulse_on(lane, !is_b), lost_[usize(other)]);
    if (jointed[usize(other)] != 0 || times_[usize(other)] == kTimes) continue;
    ++times_[usize(other)];
    thrown_.push_back(other);
  }
}

}  // namespace substep::rigid
