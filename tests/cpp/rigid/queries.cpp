#include "substep/rigid/world/queries.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <limits>

#include "shapes.h"
#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/distance/shape_distance.h"
#include "substep/rigid/distance/time_of_impact.h"

namespace {

using substep::usize;

using namespace substep::rigid;
using test::Random;

// 200 shapes of every kind, a plane and a mesh.
class Queries : public testing::Test {
 protected:
  static constexpr std::int32_t kCount = 202;

  Queries() : random_(5), scene_{broad_phase_, [this](std::int32_t f) { return placed(f); }} {
    std::vector<Bounds> all(usize(kCount));
    std::vector<std::int32_t> moving;
    for (std::int32_t f = 0; f < kCount; ++f) {
      Pose pose = random_.pose(6);
      Shape shape = random_.shape(f);
      if (f == kPlane) {
        pose = Pose(Vec3::Zero(), Quaternion::Identity());
        shape = Plane{Vec3::UnitZ(), -5};
      } else if (f == kMesh) {
        pose.position = Vec3(0, 0, -4.5);
        pose.rotation.setIdentity();
        const std::vector<Vec3> vertices{{-8, -8, 0}, {8, -8, 0}, {8, 8, 1}, {-8, 8, 0}};
        const std::vector<std::array<std::int32_t, 3>> faces{{0, 1, 2}, {0, 2, 3}};
        shape = std::make_shared<const TriangleMesh>(vertices, faces);
      }
      shapes_.push_back(shape);
      poses_.push_back(pose);
      const Motion motion = f < 200 ? Motion::kDynamic : Motion::kStatic;
      if (f == kPlane) {
        broad_phase_.add_plane(f, {-1, motion}, Vec3::UnitZ(), -5);
      } else {
        all[usize(f)] = bounds(shape, pose);
        broad_phase_.add(f, {f, motion}, all[usize(f)]);
      }
    }
    broad_phase_.update(moving, all);
  }

  static constexpr std::int32_t kPlane = 200, kMesh = 201;

  PlacedShape placed(std::int32_t f) const {
    const auto i = usize(f);
    return {&shapes_[i], poses_[i], 1u << f % 4};
  }

  Random random_;
  std::vector<Shape> shapes_;
  std::vector<Pose> poses_;
  BroadPhase broad_phase_;
  Scene scene_;
};

bool same(const FixtureHit& p, const FixtureHit& q) {
  return p.fixture == q.fixture && p.distance == q.distance && p.normal == q.normal;
}

TEST_F(Queries, RaysAgainstAllFixtures) {
  std::vector<Ray> rays;
  std::vector<FixtureHit> expected;
  std::size_t met = 0;
  for (int trial = 0; trial < 500; ++trial) {
    Ray ray{random_.vector(8), random_.direction()};
    if (trial % 3 == 0) ray.length = random_.number(0, 6);
    if (trial % 11 == 0) ray.direction = -Vec3::Unit(trial % 3);
    const std::uint32_t mask = trial % 2 == 0 ? ~0u : 5u;
    std::vector<FixtureHit> all;
    for (std::int32_t f = 0; f < kCount; ++f) {
      if ((placed(f).group & mask) == 0) continue;
      const auto hit = ray_cast(*placed(f).shape, placed(f).pose, ray);
      if (hit) all.push_back({f, hit->distance, hit->normal});
    }
    std::stable_sort(all.begin(), all.end(), [](const FixtureHit& p, const FixtureHit& q) {
      return p.distance < q.distance;
    });
    const auto through = cast_ray_through(scene_, ray, mask);
    EXPECT_TRUE(std::equal(all.begin(), all.end(), through.begin(), through.end(), same)) << trial;
    const auto first = cast_ray(scene_, ray, mask);
    ASSERT_EQ(first.has_value(), !all.empty()) << trial;
    if (first) {
      EXPECT_TRUE(same(*first, all.front())) << trial;
      EXPECT_LT(first->normal.dot(ray.direction), 0);
      ++met;
    }
    if (mask == ~0u) {
      rays.push_back(ray);
      expected.push_back(first.value_or(FixtureHit{}));
    }
  }
  EXPECT_GT(met, 200u);
  for (const int threads : {1, 3}) {
    std::vector<FixtureHit> hits(rays.size());
    cast_rays(scene_, rays, ~0u, hits, threads);
    EXPECT_TRUE(std::equal(hits.begin(), hits.end(), expected.begin(), same));
  }
}

TEST_F(Queries, EquallyNearOnesComeInOrder) {
  BroadPhase broad;
  const Shape ball = Sphere{1};
  const Pose pose{Vec3(10, 0, 0), Quaternion::Identity()};
  for (const std::int32_t f : {4, 2, 7}) broad.add(f, {f, Motion::kDynamic}, bounds(ball, pose));
  const Scene scene{broad, [&](std::int32_t) { return PlacedShape{&ball, pose}; }};
  const Ray ray{Vec3::Zero(), Vec3::UnitX()};
  EXPECT_EQ(cast_ray(scene, ray)->fixture, 2);
  const auto all = cast_ray_through(scene, ray);
  ASSERT_EQ(all.size(), 3u);
  EXPECT_EQ(all[1].fixture, 4);
  EXPECT_EQ(all[2].fixture, 7);
  EXPECT_EQ(cast_shape(scene, Sphere{0.5}, {}, Vec3::UnitX(), 20)->fixture, 2);
  EXPECT_NEAR(cast_shape(scene, Sphere{0.5}, {}, Vec3::UnitX(), 20)->distance, 8.5, 1e-7);
}

TEST_F(Queries, ShapesOnTheirWayAgainstAllFixtures) {
  int met = 0, none = 0, at_once = 0;
  for (int trial = 0; trial < 400; ++trial) {
    const Shape shape = random_.shape(trial);
    const Pose pose = random_.pose(8);
    const Vec3 direction = random_.direction();
    const double length = random_.number(0, 8);
    const auto hit = cast_shape(scene_, shape, pose, direction, length, trial % 2 ? ~0u : 3u);
    double nearest = length;
    bool any = false;
    Course course;
    course.body = pose;
    course.travel = length * direction;
    for (std::int32_t f = 0; f < kCount; ++f) {
      if ((placed(f).group & (trial % 2 ? ~0u : 3u)) == 0) continue;
      Course still;
      still.body = placed(f).pose;
      const Impact impact = time_of_impact(shape, course, *placed(f).shape, still, 0, 1e-9);
      if (impact.state == Impact::State::kApart) continue;
      any = true;
      nearest = std::min(nearest, impact.time * length);
    }
    ASSERT_EQ(hit.has_value(), any) << trial;
    if (!hit) {
      ++none;
      continue;
    }
    EXPECT_NEAR(hit->distance, nearest, 1e-5) << trial;
    (hit->distance == 0 ? at_once : met) += 1;
    EXPECT_LE(hit->normal.dot(direction), 1e-9);
  }
  EXPECT_GT(met, 40);
  EXPECT_GT(none, 10);
  EXPECT_GT(at_once, 10);
}

TEST_F(Queries, OverlapAgainstAllFixtures) {
  std::size_t seen = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const Shape shape = random_.shape(trial % 2);  // a ball or a box
    const Pose pose = random_.pose(7);
    std::vector<std::int32_t> expected;
    for (std::int32_t f = 0; f < kCount; ++f) {
      if (shape_distance(shape, pose, *placed(f).shape, placed(f).pose).value == 0 && f % 4 != 3) {
        expected.push_back(f);
      }
    }
    EXPECT_EQ(overlapping(scene_, shape, pose, 7u), expected) << trial;
    seen += expected.size();
  }
  EXPECT_GT(seen, 100u);
}

TEST_F(Queries, RefuseWhatIsNoWay) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(cast_ray(scene_, {Vec3::Zero(), Vec3::Zero()}), substep::InputError);
  EXPECT_THROW(cast_ray(scene_, {Vec3(0, kNaN, 0), Vec3::UnitX()}), substep::InputError);
  EXPECT_THROW(cast_ray_through(scene_, {Vec3::Zero(), Vec3::UnitX(), -1}), substep::InputError);
  EXPECT_THROW(cast_ray(scene_, {Vec3::Zero(), Vec3::UnitX(), kNaN}), substep::InputError);
  EXPECT_THROW(cast_shape(scene_, Sphere{1}, {}, Vec3::UnitX(), INFINITY), substep::InputError);
  EXPECT_THROW(cast_shape(scene_, Plane{Vec3::UnitX(), 0}, {}, Vec3::UnitX(), 1),
               substep::InputError);
  EXPECT_THROW(overlapping(scene_, Plane{Vec3::UnitX(), 0}, {}), substep::InputError);
  const std::vector<Ray> rays(2, {Vec3::Zero(), Vec3::UnitX()});
  std::vector<FixtureHit> hits(1);
  EXPECT_THROW(cast_rays(scene_, rays, ~0u, hits), substep::InputError);
}

}  // namespace
