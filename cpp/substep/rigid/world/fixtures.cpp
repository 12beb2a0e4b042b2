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

struct CheckShape {
  std::string where;

  void positive(const char* name, double value) const {
    if (!(value > 0) || !std::isfinite(value))
      throw InputError(where + name + ": expected a finite number above 0, got " + number(value));
  }
  void operator()(const Sphere& s) const { positive("radius", s.radius); }
  void operator()(const Box& b) const {
    for (int i = 0; i < 3; ++i) positive("half_lengths", b.half_lengths[i]);
  }
  void operator()(const Capsule& c) const {
    positive("radius", c.radius);
    positive("half_length", c.half_length);
  }
  void operator()(const Cylinder& c) const {
    positive("radius", c.radius);
    positive("half_length", c.half_length);
  }
  void operator()(const Plane& p) const {
    if (!(std::abs(p.normal.norm() - 1) < 1e-9))
      throw InputError(where + "normal: expected a direction of length 1");
    if (!std::isfinite(p.offset)) throw InputError(where + "offset: expected a finite number");
  }
  template <class T>
  void operator()(const std::shared_ptr<T>& surface) const {
    if (!surface) throw InputError(where + "shape: expected a hull or a mesh, got none");
  }
};

void check(const Fixture& fixture, const std::string& where, Motion motion) {
  std::visit(CheckShape{where}, fixture.shape);
  const auto range = [&](const char* name, double value, double most) {
    if (value >= 0 && value <= most && std::isfinite(value)) return;
    throw InputError(where + name + ": expected a finite number from 0" +
                     (most < kInfinity ? " to " + number(most) : " on") + ", got " + number(value));
  };
  range("friction", fixture.friction, kInfinity);
  range("restitution", fixture.restitution, 1);
  range("rolling", fixture.rolling, kInfinity);
  range("spinning", fixture.spinning, kInfinity);
  const Mat3& R = fixture.local.rotation;
  const double skew = (R.transpose() * R - Mat3::Identity()).lpNorm<Eigen::Infinity>();
  if (!fixture.local.position.allFinite() || !(skew < 1e-9) || R.determinant() < 0)
    throw InputError(where + "local: expected a finite position and a rotation");
  if (motion != Motion::kStatic && is_ground(fixture.shape))
    throw InputError(where + "shape: only a static body may have a plane or a mesh");
}

struct InnerBall {
  Ball operator()(const Sphere& s) const { return {Vec3::Zero(), s.radius}; }
  Ball operator()(const Box& b) const { return {Vec3::Zero(), b.half_lengths.minCoeff()}; }
  Ball operator()(const Capsule& c) const { return {Vec3::Zero(), c.radius}; }
  Ball operator()(const Cylinder& c) const {
    return {Vec3::Zero(), std::min(c.radius, c.half_length)};
  }
  Ball operator()(const std::shared_ptr<const ConvexHull>& hull) const {
    Ball ball{hull->centre(), kInfinity};
    for (int f = 0; f < hull->face_count(); ++f) {
      const FacePlane& plane = hull->plane(f);
      ball.radius = std::min(ball.radius, plane.offset - plane.normal.dot(ball.centre));
    }
    return ball;
  }
  template <class Ground>
  Ball operator()(const Ground&) const {
    return {Vec3::Zero(), kInfinity};
  }
};

struct OuterRadius {
  const Pose& local;

  // The corner of a box, or the end of an axis, that is farthest.
  double farthest(const Vec3& half) const {
    double most = 0;
    for (int k = 0; k < 8; ++k) {
      const Vec3 corner((k & 1 ? 1 : -1) * half.x(), (k & 2 ? 1 : -1) * half.y(),
                        (k & 4 ? 1 : -1) * half.z());
      most = std::max(most, local.to_world(corner).norm());
    }
    return most;
  }
  double operator()(const Sphere& s) const { return local.position.norm() + s.radius; }
  double operator()(const Box& b) const { return farthest(b.half_lengths); }
  double operator()(const Capsule& c) const { return farthest({0, 0, c.half_length}) + c.radius; }
  double operator()(const Cylinder& c) const {
    const Vec3 centre = local.rotation.transpose() * local.position;
    return std::hypot(std::hypot(centre.x(), centre.y()) + c.radius,
                      std::abs(centre.z()) + c.half_length);
  }
  double operator()(const std::shared_ptr<const ConvexHull>& hull) const {
    double most = 0;
    for (const Vec3& v : hull->vertices()) most = std::max(most, local.to_world(v).norm());
    return most;
  }
  double operator()(const Plane&) const { return 0; }
  double operator()(const std::shared_ptr<const TriangleMesh>& mesh) const {
    double most = 0;
    for (const Vec3& v : mesh->vertices()) most = std::max(most, local.to_world(v).norm());
    return most;
  }
};

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

Ball inner_ball(const Shape& shape) { return std::visit(InnerBall{}, shape); }
double outer_radius(const Shape& shape, const Pose& local) {
  return std::visit(OuterRadius{local}, shape);
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
