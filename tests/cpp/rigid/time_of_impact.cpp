#include "substep/rigid/distance/time_of_impact.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "shapes.h"
#include "substep/core/errors.h"
#include "substep/rigid/distance/shape_distance.h"

namespace {

using namespace substep::rigid;
using State = Impact::State;
using test::Random;

std::array<Vec3, 2> ends(const Capsule& capsule, const Pose& pose) {
  return {pose.to_world(Vec3(0, 0, -capsule.half_length)),
          pose.to_world(Vec3(0, 0, capsule.half_length))};
}

// Of two segments, by descent along one, then the other, from many points (both are convex).
double segment_distance(const std::array<Vec3, 2>& p, const std::array<Vec3, 2>& q) {
  const auto nearest = [](const std::array<Vec3, 2>& s, const Vec3& x) {
    const Vec3 d = s[1] - s[0];
    return Vec3(s[0] + std::clamp(d.dot(x - s[0]) / d.squaredNorm(), 0.0, 1.0) * d);
  };
  Vec3 x = p[0];
  for (int k = 0; k < 20000; ++k) x = nearest(p, nearest(q, x));
  return (x - nearest(q, x)).norm();
}

TEST(ShapeDistance, OfBoxesThatAreAlignedIsThatOfTheirGaps) {
  Random random(1);
  for (int trial = 0; trial < 2000; ++trial) {
    const Box a{{random.number(0.1, 1), random.number(0.1, 1), random.number(0.1, 1)}};
    const Box b{{random.number(0.1, 1), random.number(0.1, 1), random.number(0.1, 1)}};
    const Pose pose = random.pose(3);
    const Pose away{random.vector(4), Mat3(Mat3::Identity())};
    const Vec3 gap =
        (away.position.cwiseAbs() - a.half_lengths - b.half_lengths).cwiseMax(Vec3::Zero());
    const ShapeDistance d = shape_distance(a, pose, b, pose * away);
    EXPECT_NEAR(d.value, gap.norm(), 1e-12 * std::max(1.0, gap.norm())) << trial;
    if (gap.norm() > 1e-6) {
      const Vec3 normal = gap.cwiseProduct(away.position.cwiseSign()) / gap.norm();
      EXPECT_TRUE(d.normal.isApprox(pose.rotation * normal, 1e-9)) << trial;
    }
    // Nothing but a bound is asked for.
    const double enough = random.number(0, 3);
    const ShapeDistance some = shape_distance(a, pose, b, pose * away, enough);
    EXPECT_LE(some.value, d.value + 1e-12);
    EXPECT_GE(some.value, std::min(d.value, enough) - 1e-12);
  }
}

TEST(ShapeDistance, OfRoundShapes) {
  Random random(2);
  for (int trial = 0; trial < 300; ++trial) {
    const Capsule a{random.number(0.1, 0.3), random.number(0.1, 1)};
    const Capsule b{random.number(0.1, 0.3), random.number(0.1, 1)};
    const Pose pose_a = random.pose(2), pose_b = random.pose(2);
    const double cores = segment_distance(ends(a, pose_a), ends(b, pose_b));
    EXPECT_NEAR(shape_distance(a, pose_a, b, pose_b).value,
                std::max(0.0, cores - a.radius - b.radius), 1e-9)
        << trial;
    // A ball and a cylinder: from the side, the end, or the rim.
    const Cylinder c{random.number(0.1, 1), random.number(0.1, 1)};
    const Vec3 p = pose_a.to_local(pose_b.position);
    const double aside = std::max(0.0, p.head<2>().norm() - c.radius);
    const double above = std::max(0.0, std::abs(p.z()) - c.half_length);
    EXPECT_NEAR(shape_distance(Sphere{0.1}, pose_b, c, pose_a).value,
                std::max(0.0, std::hypot(aside, above) - 0.1), 1e-8)
        << trial;
    // A plane, either way round.
    const Plane plane{Vec3::UnitZ(), 0.5};
    const auto [low, high] = ends(a, pose_a);
    const double height = std::max(0.0, std::min(low.z(), high.z()) - a.radius - 0.5);
    const ShapeDistance d = shape_distance(a, pose_a, plane, {});
    EXPECT_NEAR(d.value, height, 1e-14);
    EXPECT_EQ(shape_distance(plane, {}, a, pose_a).value, d.value);
    EXPECT_TRUE(height == 0 || d.normal == -Vec3::UnitZ());
  }
  EXPECT_THROW(shape_distance(Plane{Vec3::UnitZ(), 0}, {}, Plane{Vec3::UnitZ(), 0}, {}),
               substep::InputError);
}

// A simplex may be flat by rounding, mostly with cylinders: that is no overlap.
TEST(ShapeDistance, DoesNotDependOnTheOrder) {
  Random random(7);
  for (int trial = 0; trial < 25000; ++trial) {
    const Shape a = random.shape(trial % 5 == 4 ? 3 : trial), b = random.shape(trial / 5);
    const Pose pose_a = random.pose(2), pose_b = random.pose(2);
    const ShapeDistance d = shape_distance(a, pose_a, b, pose_b);
    const ShapeDistance e = shape_distance(b, pose_b, a, pose_a);
    ASSERT_NEAR(d.value, e.value, 1e-7) << trial;
    if (d.value > 1e-3) {
      ASSERT_LT((d.normal + e.normal).norm(), 1e-3) << trial;
    }
  }
}

// Two triangles that meet at an edge, like a roof.
std::shared_ptr<const TriangleMesh> roof() {
  const std::vector<Vec3> vertices{{-1, 0, 0}, {0, -1, 1}, {0, 1, 1}, {1, 0, 0}};
  const std::vector<std::array<std::int32_t, 3>> faces{{0, 1, 2}, {1, 3, 2}};
  return std::make_shared<const TriangleMesh>(vertices, faces);
}

TEST(ShapeDistance, OfMeshes) {
  const Shape ball = Sphere{0.25};
  EXPECT_NEAR(shape_distance(ball, {Vec3(0, 0, 3), Mat3(Mat3::Identity())}, roof(), {}).value, 1.75,
              1e-12);
  EXPECT_NEAR(shape_distance(roof(), {}, ball, {Vec3(4, 0, 0), Mat3(Mat3::Identity())}).value, 2.75,
              1e-12);
  const ShapeDistance far =
      shape_distance(ball, {Vec3(0, 0, 3000), Mat3(Mat3::Identity())}, roof(), {});
  EXPECT_NEAR(far.value, 2998.75, 1e-9);
  EXPECT_NEAR(far.normal.z(), -1, 1e-12);
  const double some =
      shape_distance(ball, {Vec3(0, 0, 3000), Mat3(Mat3::Identity())}, roof(), {}, 5).value;
  EXPECT_GE(some, 5);
  EXPECT_LE(some, 2998.75);
  EXPECT_EQ(shape_distance(ball, {Vec3(0, 0, 1.2), Mat3(Mat3::Identity())}, roof(), {}).value, 0);
}

Course straight(const Vec3& from, const Vec3& travel) {
  Course course;
  course.body.position = from;
  course.travel = travel;
  return course;
}

TEST(TimeOfImpact, ASphereAtAThousandMetresPerSecondMeetsAPlateOfOneCentimetre) {
  const Shape ball = Sphere{0.01}, plate = Box{Vec3(2, 2, 0.005)};
  for (const double h : {1.0 / 60, 1.0 / 240}) {
    for (const double height : {0.01511, 0.5, 3.0}) {
      for (const double aslant : {0.0, 0.3}) {
        const Course course =
            straight(Vec3(0, 0, height), h * 1000 * Vec3(std::sin(aslant), 0, -std::cos(aslant)));
        const Impact impact = time_of_impact(ball, course, plate, Course{}, 1e-4, 1e-9);
        ASSERT_EQ(impact.state, State::kTouching);
        const double expected = (height - 0.0151) / (h * 1000 * std::cos(aslant));
        EXPECT_NEAR(impact.time, expected, 1e-9);
        EXPECT_LE(impact.time, expected + 1e-15);
        EXPECT_NEAR(impact.normal.z(), -1, 1e-12);
      }
    }
    // It ends before the plate, passes beside it, or leaves it.
    EXPECT_EQ(time_of_impact(ball, straight(Vec3(0, 0, 1), Vec3(0, 0, -0.98)), plate, Course{},
                             1e-4, 1e-9)
                  .state,
              State::kApart);
    EXPECT_EQ(time_of_impact(ball, straight(Vec3(2.02, 0, 1), Vec3(0, 0, -16)), plate, Course{},
                             1e-4, 1e-9)
                  .state,
              State::kApart);
    EXPECT_EQ(time_of_impact(ball, straight(Vec3(0, 0, 0.01502), Vec3(0, 0, 16)), plate, Course{},
                             1e-4, 1e-9)
                  .state,
              State::kApart);
    // Within the target it touches at once; in the plate it cannot say.
    const Impact near = time_of_impact(ball, straight(Vec3(0, 0, 0.01502), Vec3(0, 0, -1)), plate,
                                       Course{}, 1e-4, 1e-9);
    EXPECT_EQ(near.state, State::kTouching);
    EXPECT_EQ(near.time, 0);
    EXPECT_EQ(time_of_impact(ball, straight(Vec3(0, 0, 0.012), Vec3(0, 0, -1)), plate, Course{},
                             1e-4, 1e-9)
                  .state,
              State::kOverlap);
  }
}

TEST(TimeOfImpact, OfTwoBallsIsTheRootOfAQuadratic) {
  Random random(4);
  int met = 0;
  for (int trial = 0; trial < 1000; ++trial) {
    const double p = random.number(0.1, 1), q = random.number(0.1, 1), target = 0.01;
    const Course a = straight(random.vector(4), random.vector(8));
    Course b = straight(random.vector(4), Vec3::Zero());  // about to where a goes
    b.travel = a.body.position + a.travel + random.vector(1.5) - b.body.position;
    const Vec3 x = b.body.position - a.body.position, v = b.travel - a.travel;
    const double sum = p + q + target;
    if (x.norm() <= sum + 1e-6) continue;
    const double half = x.dot(v), discriminant = half * half - v.dot(v) * (x.dot(x) - sum * sum);
    if (std::abs(discriminant) < 1e-2) continue;  // grazing
    const double root = discriminant > 0 ? (-half - std::sqrt(discriminant)) / v.dot(v) : -1;
    const Impact impact = time_of_impact(Sphere{p}, a, Sphere{q}, b, target, 1e-10);
    ASSERT_EQ(impact.state == State::kTouching, root > 0 && root < 1) << trial;
    if (impact.state != State::kTouching) continue;
    ++met;
    EXPECT_NEAR(impact.time, root, 1e-8) << trial;
  }
  EXPECT_GT(met, 150);
}

TEST(TimeOfImpact, OfABoxThatTurnsAboveAPlane) {
  // Its lowest edge is at z - (a sin s + c cos s) for a turn by s about y.
  const double a = 0.8, c = 0.3, z = 0.7, target = 1e-3;
  Course course;
  course.body.position = Vec3(0, 0, z);
  course.turn = Vec3(0, 1.2, 0);
  const double size = std::hypot(a, c);
  const double s = std::atan2(a, c) - std::acos((z - target) / size);
  for (const double tolerance : {1e-6, 1e-9}) {
    const Impact impact = time_of_impact(Box{Vec3(a, 0.5, c)}, course, Plane{Vec3::UnitZ(), 0},
                                         Course{}, target, tolerance);
    ASSERT_EQ(impact.state, State::kTouching);
    EXPECT_LE(impact.time, s / 1.2);
    EXPECT_NEAR(impact.time, s / 1.2, 4 * tolerance);
  }
  // The same box as a shape that stands aside of the centre of its body.
  Course aside = course;
  aside.local.position = Vec3(0.3, 0, 0);
  aside.body.position -= Vec3(0.3, 0, 0);
  const Impact impact =
      time_of_impact(Box{Vec3(a, 0.5, c)}, aside, Plane{Vec3::UnitZ(), 0}, Course{}, target, 1e-9);
  const double lever = std::hypot(a + 0.3, c);
  const double turned = std::atan2(a + 0.3, c) - std::acos((z - target) / lever);
  EXPECT_NEAR(impact.time, turned / 1.2, 1e-8);
}

// Nothing is nearer than the target before the time, and just that at it.
TEST(TimeOfImpact, AgainstManySmallSteps) {
  Random random(6);
  int touching = 0, apart = 0;
  for (int trial = 0; trial < 400; ++trial) {
    const Shape a = random.shape(trial), b = random.shape(trial / 5);
    Course courses[2];
    for (Course& course : courses) {
      course.body = random.pose(3);
      course.travel = random.vector(1.5) - course.body.position;
      course.turn = random.vector(1.5);
      course.local = random.pose(0.3);
    }
    const double target = 0.01, tolerance = 1e-6;
    const Impact impact = time_of_impact(a, courses[0], b, courses[1], target, tolerance);
    const auto distance = [&](double t) {
      return shape_distance(a, courses[0].at(t), b, courses[1].at(t)).value;
    };
    if (impact.state == State::kOverlap) {
      EXPECT_EQ(distance(0), 0);
      continue;
    }
    if (distance(0) <= target) continue;
    const double end = impact.state == State::kTouching ? impact.time : 1;
    for (int k = 0; k <= 50; ++k) EXPECT_GE(distance(end * k / 50), target - 1e-8) << trial;
    if (impact.state == State::kTouching) {
      ++touching;
      EXPECT_LE(distance(end), target + tolerance + 1e-9) << trial;
      const Impact flipped = time_of_impact(b, courses[1], a, courses[0], target, tolerance);
      EXPECT_NEAR(flipped.time, impact.time, 1e-5) << trial;
    } else {
      ++apart;
    }
  }
  EXPECT_GT(touching, 80);
  EXPECT_GT(apart, 100);
}

TEST(TimeOfImpact, OnAMesh) {
  const Shape box = Box{Vec3(0.1, 0.1, 0.1)};
  Course fast = straight(Vec3(0, 0, 5), Vec3(0, 0, -20));
  fast.turn = Vec3(0, 0, 0.4);
  const Impact impact = time_of_impact(box, fast, roof(), Course{}, 1e-3, 1e-9);
  ASSERT_EQ(impact.state, State::kTouching);
  EXPECT_NEAR(impact.time, (4 - 0.1 - 1e-3) / 20, 1e-9);
  const Impact flipped = time_of_impact(roof(), Course{}, box, fast, 1e-3, 1e-9);
  EXPECT_EQ(flipped.time, impact.time);
  EXPECT_EQ(flipped.normal, -impact.normal);
  // From below it is not there.
  EXPECT_EQ(
      time_of_impact(box, straight(Vec3(0, 0, -5), Vec3(0, 0, 20)), roof(), Course{}, 1e-3, 1e-9)
          .state,
      State::kApart);
  EXPECT_THROW(time_of_impact(box, fast, roof(), fast, 1e-3, 1e-9), substep::InputError);
}

}  // namespace
