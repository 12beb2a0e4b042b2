#include "substep/rigid/world/fixtures.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/reserve.h"
#include "substep/core/usize.h"
#include "substep/rigid/shapes/mass_properties.h"

namespace substep::rigid {
namespace {

constexpr double kMarginOfInner = 0.1;  // margin of small shapes, of the inner radius
constexpr double kInfinity = std::numeric_limits<double>::infinity();

std::string number(double value) { return std::to_string(value); }

void check(const Fixture& fixture, const std::string& where, Motion motion) {
  check_shape(fixture.shape, where);
  const auto range = [&](const char* name, double value, double most) {
    if (value >= 0 && value <= most && std::isfinite(value)) return;
    throw InputError(where + name + ": expected a finite number from 0" +
                     (most < kInfinity ? " to " + number(most) : " on") + ", got " + number(value));
  };
  range("friction", fixture.friction, kInfinity);
  range("restitution", fixture.restitution, 1);
  if (const double most = fixture.static_friction.value_or(fixture.friction);
      !(most >= fixture.friction && std::isfinite(most)))
    throw InputError(where + "static_friction: expected a finite number, at least the friction, " +
                     number(fixture.friction) + ", got " + number(most));
  if (fixture.material.find('\0') != std::string::npos)
    throw InputError(where + "material: expected a name without null characters");
  range("rolling", fixture.rolling, kInfinity);
  range("spinning", fixture.spinning, kInfinity);
  const Mat3& R = fixture.local.rotation;
  const double skew = (R.transpose() * R - Mat3::Identity()).lpNorm<Eigen::Infinity>();
  if (!fixture.local.position.allFinite() || !(skew < 1e-9) || R.determinant() < 0)
    throw InputError(where + "local: expected a finite position and a rotation");
  if (motion != Motion::kStatic && is_ground(fixture.shape))
    throw InputError(where + "shape: only a static body may have a plane or a mesh");
}

}  // namespace

void check_fixtures(std::span<const Fixture> fixtures, Motion motion) {
  for (std::size_t k = 0; k < fixtures.size(); ++k)
    check(fixtures[k], "fixture " + std::to_string(k) + ": ", motion);
}

BodyState assemble(const BodyState& frame, std::span<Fixture> fixtures) {
  const MassProperties mass = principal(moments(fixtures));
  const Pose own(mass.centre, mass.axes);
  for (Fixture& fixture : fixtures) fixture.local = fixture.local.relative_to(own);
  BodyState body = frame;
  const Quaternion rotation = frame.rotation.normalized();
  body.position = frame.position + rotation * mass.centre;
  body.rotation = rotation * mass.axes;
  body.mass = mass.mass;
  body.inertia = mass.inertia;
  return body;
}

void Fixtures::add(std::span<const Fixture> fixtures, double margin) {
  const std::size_t n = entries_.size() + fixtures.size();
  std::vector<Entry> entries;
  for (const Fixture& fixture : fixtures) {
    const Ball core = inner_ball(fixture.shape);
    entries.push_back({fixture, static_cast<std::int32_t>(first_.size()) - 1, core,
                       outer_radius(fixture.shape, fixture.local),
                       std::min(margin, kMarginOfInner * core.radius)});
  }
  make_room(1, fixtures.size());
  entries_.insert(entries_.end(), entries.begin(), entries.end());
  pose_.resize(n);
  bounds_.resize(n, Bounds{Vec3::Zero(), Vec3::Zero()});
  body_pose_.emplace_back();
  Size& size = sizes_.emplace_back();
  for (const Entry& entry : entries) {
    size.outer = std::max(size.outer, entry.outer);
    size.inner = std::min(size.inner, entry.core.radius);
    size.off_centre =
        std::max(size.off_centre, entry.fixture.local.to_world(entry.core.centre).norm());
  }
  first_.push_back(static_cast<std::int32_t>(n));
}

void Fixtures::make_room(std::size_t bodies, std::size_t fixtures) {
  const std::size_t b = sizes_.size() + bodies, f = entries_.size() + fixtures;
  reserve_amortised(entries_, f), reserve_amortised(pose_, f), reserve_amortised(bounds_, f);
  reserve_amortised(first_, b + 1), reserve_amortised(body_pose_, b), reserve_amortised(sizes_, b);
}

void Fixtures::remove_last_body() {
  first_.pop_back(), body_pose_.pop_back(), sizes_.pop_back();
  const auto n = usize(first_.back());
  entries_.erase(entries_.begin() + first_.back(), entries_.end());
  pose_.resize(n), bounds_.resize(n);
}

std::vector<std::int32_t> Fixtures::renumber(std::span<const std::int64_t> bodies) {
  std::vector<std::int32_t> numbers(entries_.size(), -1), first{0};
  std::int32_t next = 0;
  for (std::size_t b = 0; b < bodies.size(); ++b) {
    if (bodies[b] < 0) continue;
    for (std::int32_t f = first_[b]; f < first_[b + 1]; ++f, ++next) {
      numbers[usize(f)] = next;
      entries_[usize(next)] = entries_[usize(f)];
      entries_[usize(next)].body = static_cast<std::int32_t>(bodies[b]);
      pose_[usize(next)] = pose_[usize(f)];
      bounds_[usize(next)] = bounds_[usize(f)];
    }
    body_pose_[usize(bodies[b])] = body_pose_[b];
    sizes_[usize(bodies[b])] = sizes_[b];
    first.push_back(next);
  }
  entries_.erase(entries_.begin() + next, entries_.end());
  body_pose_.resize(first.size() - 1);
  sizes_.resize(first.size() - 1);
  pose_.resize(usize(next));
  bounds_.resize(usize(next));
  first_.swap(first);
  return numbers;
}

double Fixtures::restitution(const Fixture& a, const Fixture& b) const {
  const MaterialPair* pair = material_pairs_.find(a.material, b.material);
  return pair && pair->restitution ? *pair->restitution : std::max(a.restitution, b.restitution);
}

Surface Fixtures::surface(const Fixture& a, const Fixture& b) const {
  const auto sticks = [](const Fixture& f) { return f.static_friction.value_or(f.friction); };
  Surface surface{std::sqrt(a.friction * b.friction), std::sqrt(sticks(a) * sticks(b)),
                  std::max(a.restitution, b.restitution), std::max(a.rolling, b.rolling),
                  std::max(a.spinning, b.spinning)};
  if (const MaterialPair* pair = material_pairs_.find(a.material, b.material)) {
    if (pair->friction) {
      surface.friction = *pair->friction;
      surface.static_friction = pair->static_friction.value_or(*pair->friction);
    }
    surface.restitution = pair->restitution.value_or(surface.restitution);
    surface.rolling = pair->rolling.value_or(surface.rolling);
    surface.spinning = pair->spinning.value_or(surface.spinning);
  }
  return surface;
}

// The bounds of a body that turns far are those of a ball.
void Fixtures::place(std::int64_t b, const Pose& pose, const Way& way) {
  body_pose_[usize(b)] = pose;
  for (std::int32_t f = first(b); f < first(b + 1); ++f) {
    const Entry& entry = entries_[usize(f)];
    const Pose& local = entry.fixture.local;
    pose_[usize(f)] = pose * local;
    Bounds box = rigid::bounds(entry.fixture.shape, pose_[usize(f)]);
    if (is_ground(entry.fixture.shape)) {
      bounds_[usize(f)] = box;
      continue;
    }
    const double sweep = entry.margin + way.angle * entry.outer;
    box.low.array() -= sweep, box.high.array() += sweep;
    if (way.angle > 0.5) {
      const double around = entry.margin + entry.outer;
      box.low = box.low.cwiseMax((pose.position.array() - around).matrix());
      box.high = box.high.cwiseMin((pose.position.array() + around).matrix());
    }
    box.low += way.travel.cwiseMin(0.), box.high += way.travel.cwiseMax(0.);
    bounds_[usize(f)] = box;
  }
}

}  // namespace substep::rigid
