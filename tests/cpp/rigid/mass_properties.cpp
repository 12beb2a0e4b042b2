// Mass properties against closed forms: a shape and its mesh, or a shape and its parts, agree.
#include "substep/rigid/shapes/mass_properties.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "substep/core/errors.h"

namespace {

using namespace substep;
using namespace substep::rigid;
using std::numbers::pi;

void expect_near(const MassMoments& a, const MassMoments& b, double tolerance) {
  EXPECT_NEAR(a.mass / b.mass, 1, tolerance);
  EXPECT_LT((a.centre - b.centre).norm(), tolerance * (1 + b.centre.norm()));
  EXPECT_LT((a.inertia - b.inertia).norm(), tolerance * b.inertia.norm());
}

struct Mesh {
  std::vector<double> vertices;
  std::vector<std::int64_t> faces;
};
MassMoments moments(const Mesh& mesh, double density) {
  return rigid::moments(mesh.vertices, mesh.faces, density);
}

// A box [-h, h], its faces looking outward.
Mesh box(const Vec3& h, const Pose& pose = {}) {
  Mesh mesh;
  for (int k = 0; k < 8; ++k) {
    const Vec3 x =
        pose.to_world({k & 1 ? h.x() : -h.x(), k & 2 ? h.y() : -h.y(), k & 4 ? h.z() : -h.z()});
    mesh.vertices.insert(mesh.vertices.end(), x.begin(), x.end());
  }
  mesh.faces = {0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4,
                2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5};
  return mesh;
}

// The solid of revolution about z of a profile (r, z) from pole to pole, upward.
Mesh revolution(const std::vector<std::array<double, 2>>& profile, int n) {
  Mesh mesh;
  for (const auto& [r, z] : profile)
    for (int k = 0; k < n; ++k) {
      const double angle = 2 * pi * k / n;
      mesh.vertices.insert(mesh.vertices.end(), {r * std::cos(angle), r * std::sin(angle), z});
    }
  mesh.vertices.insert(mesh.vertices.end(), {0, 0, profile.front()[1], 0, 0, profile.back()[1]});
  const auto rings = static_cast<std::int64_t>(profile.size());
  for (std::int64_t k = 0; k < n; ++k) {
    const std::int64_t next = (k + 1) % n, top = (rings - 1) * n;
    mesh.faces.insert(mesh.faces.end(), {next, k, rings * n, top + k, top + next, rings * n + 1});
    for (std::int64_t i = 0; i + 1 < rings; ++i) {
      const std::int64_t a = i * n + k, b = i * n + next;
      mesh.faces.insert(mesh.faces.end(), {a, b, b + n, a, b + n, a + n});
    }
  }
  return mesh;
}

const Pose kElsewhere({3, -2, 0.5}, rotation_by({0.4, -1.1, 0.8}));

TEST(MassProperties, OfABoxAreThoseOfItsMesh) {
  const Box shape{{0.5, 0.25, 0.1}};
  const MassMoments closed = rigid::moments(shape, 700);
  EXPECT_DOUBLE_EQ(closed.mass, 700 * 0.1);
  EXPECT_DOUBLE_EQ(closed.inertia(2, 2), closed.mass * (1 + 0.25) / 12);
  expect_near(moments(box(shape.half_lengths), 700), closed, 1e-14);
  expect_near(moments(box(shape.half_lengths, kElsewhere), 700), moved(closed, kElsewhere), 1e-14);
  // Far away: what is lost is what the positions lose.
  const Pose far({1e6, -1e6, 1e6}, kElsewhere.rotation);
  expect_near(moments(box(shape.half_lengths, far), 700), moved(closed, far), 1e-8);
}

TEST(MassProperties, OfAConvexHullAreThoseOfItsCorners) {
  const Box shape{{0.5, 0.25, 0.1}};
  const Mesh mesh = box(shape.half_lengths, kElsewhere);
  std::vector<Vec3> corners;
  for (std::size_t k = 0; k < 24; k += 3) corners.emplace_back(&mesh.vertices[k]);
  corners.push_back(kElsewhere.to_world({0.1, 0.1, 0}));  // inside
  expect_near(rigid::moments(std::make_shared<const ConvexHull>(corners), 700),
              moved(rigid::moments(shape, 700), kElsewhere), 1e-14);
}

TEST(MassProperties, OfRoundShapesAreTheLimitsOfTheirMeshes) {
  // A polygon of n corners has the area and the second moment of a circle but for O(1 / n^2).
  for (const int n : {40, 80}) {
    const double tolerance = 20.0 / (n * n), r = 0.3, h = 0.7;
    std::vector<std::array<double, 2>> ball, capsule;
    for (int i = 1; i < n; ++i) {
      const double angle = pi * i / n - pi / 2, x = r * std::cos(angle), z = r * std::sin(angle);
      ball.push_back({x, z});
      capsule.push_back({x, z + (2 * i < n ? -h : h)});
      if (2 * i == n) capsule.insert(capsule.end() - 1, {x, z - h});
    }
    expect_near(moments(revolution(ball, n), 2), rigid::moments(Sphere{r}, 2), tolerance);
    expect_near(moments(revolution(capsule, n), 2), rigid::moments(Capsule{r, h}, 2), tolerance);
    expect_near(moments(revolution({{r, -h}, {r, h}}, n), 2), rigid::moments(Cylinder{r, h}, 2),
                tolerance);
  }
  const double r = 0.3;
  EXPECT_DOUBLE_EQ(rigid::moments(Sphere{r}, 2).mass, 8. / 3 * pi * r * r * r);
  // A capsule without a tube is a sphere.
  expect_near(rigid::moments(Capsule{r, 1e-12}, 2), rigid::moments(Sphere{r}, 2), 1e-11);
}

TEST(MassProperties, OfPolygonalPrismsAndTetrahedraAreExact) {
  // Prism over a regular polygon of n corners on the circle of radius r: area n r^2 sin(a) / 2,
  // second moment about its axis over the area r^2 (2 + cos(a)) / 6, a = 2 pi / n.
  const double r = 0.8, h = 0.45;
  for (const int n : {3, 5, 8}) {
    const double a = 2 * pi / n, area = n * r * r * std::sin(a) / 2;
    const MassMoments prism = moments(revolution({{r, -h}, {r, h}}, n), 3);
    EXPECT_NEAR(prism.mass, 3 * area * 2 * h, 1e-14);
    EXPECT_NEAR(prism.inertia(2, 2), prism.mass * r * r * (2 + std::cos(a)) / 6, 1e-14);
    EXPECT_NEAR(prism.inertia(0, 0), prism.mass * (r * r * (2 + std::cos(a)) / 12 + h * h / 3),
                1e-14);
  }
  // The corner of a cube: mass 1 / 6, centre 1 / 4, int x^2 = 1 / 60, int x y = 1 / 120.
  const Mesh corner{{0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}};
  const MassMoments m = moments(corner, 1);
  EXPECT_DOUBLE_EQ(m.mass, 1. / 6);
  EXPECT_LT((m.centre - Vec3::Constant(0.25)).norm(), 1e-15);
  EXPECT_NEAR(m.inertia(0, 0), 2. / 60 - 2. / 96, 1e-16);
  EXPECT_NEAR(m.inertia(0, 1), -(1. / 120 - 1. / 96), 1e-16);
}

TEST(MassProperties, OfPartsAddUp) {
  // A box cut in two, and a hollow box as one box less another.
  const MassMoments half = rigid::moments(Box{{0.5, 0.2, 0.1}}, 5);
  const MassMoments parts[] = {moved(half, {Vec3(-0.5, 0, 0), Mat3(Mat3::Identity())}),
                               moved(half, {Vec3(0.5, 0, 0), Mat3(Mat3::Identity())})};
  expect_near(sum(parts), rigid::moments(Box{{1, 0.2, 0.1}}, 5), 1e-15);
  const MassMoments turned[] = {moved(parts[0], kElsewhere), moved(parts[1], kElsewhere)};
  expect_near(sum(turned), moved(rigid::moments(Box{{1, 0.2, 0.1}}, 5), kElsewhere), 1e-14);

  const Fixture dumbbell[] = {
      {.shape = Sphere{0.2}, .local = {Vec3(0, 0, 1), Mat3(Mat3::Identity())}},
      {.shape = Cylinder{0.05, 0.8}, .local = {}, .density = 500},
      {.shape = Sphere{0.2}, .local = {Vec3(0, 0, -1), Mat3(Mat3::Identity())}}};
  const MassMoments whole = rigid::moments(dumbbell), ball = rigid::moments(Sphere{0.2}, 1000),
                    rod = rigid::moments(Cylinder{0.05, 0.8}, 500);
  EXPECT_DOUBLE_EQ(whole.mass, 2 * ball.mass + rod.mass);
  EXPECT_DOUBLE_EQ(whole.inertia(0, 0), 2 * (ball.inertia(0, 0) + ball.mass) + rod.inertia(0, 0));
  EXPECT_DOUBLE_EQ(whole.inertia(2, 2), 2 * ball.inertia(2, 2) + rod.inertia(2, 2));

  Mesh hollow = box({1, 1, 1}), hole = box({0.5, 0.5, 0.5});
  for (std::size_t k = 0; k < hole.faces.size(); k += 3)
    hollow.faces.insert(hollow.faces.end(),
                        {hole.faces[k] + 8, hole.faces[k + 2] + 8, hole.faces[k + 1] + 8});
  hollow.vertices.insert(hollow.vertices.end(), hole.vertices.begin(), hole.vertices.end());
  const MassMoments shell = moments(hollow, 1);
  EXPECT_DOUBLE_EQ(shell.mass, 7);
  EXPECT_NEAR(shell.inertia(0, 0), 8 * 2. / 3 - 1. * 2 / 12, 1e-14);
}

TEST(Principal, IsTheFrameItselfWhereInertiaIsDiagonal) {
  for (const Vec3& I : {Vec3(3, 2, 4), Vec3(2, 2, 3), Vec3(1, 1, 1), Vec3(2, 3, 2)}) {
    const MassProperties p = principal({2, Vec3(1, 2, 3), I.asDiagonal()});
    EXPECT_EQ(p.axes.coeffs(), Quaternion::Identity().coeffs());
    EXPECT_EQ(p.inertia, I);
    EXPECT_EQ(p.centre, Vec3(1, 2, 3));
    EXPECT_EQ(p.mass, 2);
  }
  // Rounding gives a ball no axes.
  const MassMoments ball = rigid::moments(Sphere{0.3}, 2);
  EXPECT_EQ(principal(moved(ball, kElsewhere)).axes.coeffs(), Quaternion::Identity().coeffs());
}

TEST(Principal, DiagonalisesWithTheNearestRightHandedFrame) {
  for (const Vec3& a : {Vec3(0.1, 0.2, -0.3), Vec3(1, -2, 0.5), Vec3(0, 0, pi / 2), Vec3(3, 0, 0)})
    for (const Vec3& I :
         {Vec3(3, 2, 4), Vec3(2, 2, 3), Vec3(3, 4, 1.00001), Vec3(1, 1 + 1e-9, 1)}) {
      const Mat3 R = rotation_by(a).toRotationMatrix();
      const MassMoments solid{1, Vec3::Zero(), R * I.asDiagonal() * R.transpose()};
      const MassProperties p = principal(solid);
      const Mat3 V = p.axes.toRotationMatrix();
      EXPECT_LT((V * p.inertia.asDiagonal() * V.transpose() - solid.inertia).norm(), 1e-13);
      // Of the 24 frames the nearest is within 62.8 degrees (Mackenzie 1958, Biometrika 45).
      EXPECT_GE(V.trace(), 1.91);
      EXPECT_EQ(principal(solid).axes.coeffs(), p.axes.coeffs());
    }
  const Vec3 small(0.1, 0.2, -0.3), I(3, 2, 4);
  const Mat3 R = rotation_by(small).toRotationMatrix();
  const MassProperties p = principal({1, Vec3::Zero(), R * I.asDiagonal() * R.transpose()});
  EXPECT_LT((rotation_vector(p.axes) - small).norm(), 1e-14);
  EXPECT_LT((p.inertia - I).norm(), 1e-14);
}

template <class Call>
void expect_refused(Call&& call, const std::string& wanted) {
  try {
    call();
    ADD_FAILURE() << "accepted; expected: " << wanted;
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find(wanted), std::string::npos) << error.what();
  }
}

TEST(MassProperties, RefuseWhatIsNoSolid) {
  const Mesh good = box({1, 1, 1});
  Mesh mesh = good;
  mesh.faces.resize(33);
  expect_refused([&] { moments(mesh, 1); }, "belongs to no other face");
  mesh = good;
  std::swap(mesh.faces[0], mesh.faces[1]);
  expect_refused([&] { moments(mesh, 1); }, "is run through in the same direction");
  mesh = good;
  for (std::size_t k = 0; k < 36; k += 3) std::swap(mesh.faces[k], mesh.faces[k + 1]);
  expect_refused([&] { moments(mesh, 1); }, "inside out");
  mesh = box({1, 1, 0});
  expect_refused([&] { moments(mesh, 1); }, "no volume");
  mesh = good;
  mesh.vertices[4] = std::nan("");
  expect_refused([&] { moments(mesh, 1); }, "not finite");
  mesh = good;
  mesh.faces[5] = 8;
  expect_refused([&] { moments(mesh, 1); },
                 "faces[1]: expected three different indices from 0 to 7");
  mesh.faces[5] = mesh.faces[4];
  expect_refused([&] { moments(mesh, 1); }, "faces[1]");
  mesh.faces.clear();
  expect_refused([&] { moments(mesh, 1); }, "at least one face");
  expect_refused([&] { moments(good, 0); }, "density");
  for (const double bad : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
    expect_refused([&] { rigid::moments(Sphere{bad}, 1); }, "radius");
    expect_refused([&] { rigid::moments(Sphere{1}, bad); }, "density");
    expect_refused([&] { rigid::moments(Box{{1, bad, 1}}, 1); }, "half_lengths");
    expect_refused([&] { rigid::moments(Capsule{1, bad}, 1); }, "half_length");
    expect_refused([&] { rigid::moments(Cylinder{bad, 1}, 1); }, "radius");
  }
  const Fixture ground{.shape = Plane{Vec3::UnitZ(), 0}, .local = {}};
  expect_refused([&] { rigid::moments(std::span(&ground, 1)); }, "without volume");
}

TEST(Principal, RefusesWhatNoBodyHas) {
  const auto with = [](double mass, const Mat3& I) {
    return [=] { principal({mass, Vec3::Zero(), I}); };
  };
  const Mat3 one = Mat3::Identity();
  expect_refused(with(0, one), "mass");
  expect_refused(with(std::nan(""), one), "mass");
  expect_refused(with(1, Vec3(1, 1, 0).asDiagonal()), "above 0");
  expect_refused(with(1, Vec3(1, -1, 1).asDiagonal()), "above 0");
  expect_refused(with(1, Vec3(1, 1, 2.1).asDiagonal()), "sum of the other two");
  Mat3 skew = one;
  skew(0, 1) = 0.1;
  expect_refused(with(1, skew), "symmetric");
  expect_refused(with(1, one * std::nan("")), "symmetric");
  EXPECT_NO_THROW(with(1, Vec3(1, 1, 2).asDiagonal())());  // a flat plate
}

}  // namespace
