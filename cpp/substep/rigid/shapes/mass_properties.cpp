#include "substep/rigid/shapes/mass_properties.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>
#include <string>
#include <tuple>
#include <variant>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace substep::rigid {

MassMoments moments(const Shape& shape, double density) {
  Expect{}.positive("density", density);
  check_shape(shape, "");
  const auto own = [&](const auto& s) -> MassMoments {
    if constexpr (ConvexShape<decltype(s)>) {
      return shape_of(s).moments(density);
    } else {
      throw InputError("shape: only a body that never moves may have a shape without volume");
    }
  };
  return std::visit(own, shape);
}

// Of the tetrahedron (0, a, b, c) with d = det(a, b, c): int dV = d / 6, int x dV = d s / 24,
// int x x^T dV = d (a a^T + b b^T + c c^T + s s^T) / 120, s = a + b + c.
void SolidIntegrals::add(const Vec3& a0, const Vec3& b0, const Vec3& c0) {
  const Vec3 a = a0 - origin_, b = b0 - origin_, c = c0 - origin_, s = a + b + c;
  const double d = a.dot(b.cross(c));
  volume_ += d;
  first_ += d * s;
  second_ += d * (a * a.transpose() + b * b.transpose() + c * c.transpose() + s * s.transpose());
}

MassMoments SolidIntegrals::moments(double density) const {
  const Vec3 centre = first_ / (4 * volume_);
  const Mat3 about = second_ / 120 - volume_ / 6 * centre * centre.transpose();
  return {density * volume_ / 6, origin_ + centre,
          density * (about.trace() * Mat3::Identity() - about)};
}

namespace {

// Every edge must be run through as often forward as backward: then the mesh has no border.
void check_closed(std::span<const std::int64_t> faces) {
  struct Side {
    std::int64_t low, high, face;
    int direction;
  };
  std::vector<Side> sides;
  sides.reserve(faces.size());
  for (std::size_t f = 0; f < faces.size(); f += 3)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::int64_t i = faces[f + k], j = faces[f + (k + 1) % 3];
      sides.push_back(
          {std::min(i, j), std::max(i, j), static_cast<std::int64_t>(f / 3), i < j ? 1 : -1});
    }
  std::sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) {
    return std::tie(a.low, a.high, a.face) < std::tie(b.low, b.high, b.face);
  });
  for (std::size_t i = 0, end; i < sides.size(); i = end) {
    int balance = 0;
    for (end = i;
         end < sides.size() && sides[end].low == sides[i].low && sides[end].high == sides[i].high;
         ++end)
      balance += sides[end].direction;
    if (balance == 0) continue;
    std::ostringstream text;
    text << "faces[" << sides[i].face << "]: the mesh is not closed: the edge (" << sides[i].low
         << ", " << sides[i].high << ") ";
    if (end - i == 1) {
      text << "belongs to no other face";
    } else {
      text << "of " << end - i << " faces is run through in the same direction by faces["
           << sides[i + 1].face << "]";
    }
    throw InputError(text.str());
  }
}

}  // namespace

MassMoments moments(std::span<const double> vertices, std::span<const std::int64_t> faces,
                    double density) {
  Expect{}.positive("density", density);
  const auto n = static_cast<std::int64_t>(vertices.size() / 3);
  for (std::size_t k = 0; k < faces.size(); ++k)
    if (faces[k] < 0 || faces[k] >= n || faces[k] == faces[k - k % 3 + (k + 1) % 3])
      throw InputError("faces[" + std::to_string(k / 3) + "]: expected three different indices " +
                       "from 0 to " + std::to_string(n - 1));
  if (faces.empty()) throw InputError("faces: expected at least one face");
  check_closed(faces);

  const auto vertex = [&](std::int64_t i) { return Vec3(vertices.data() + 3 * i); };
  Vec3 low = vertex(faces[0]), high = low;
  for (const std::int64_t i : faces) {
    low = low.cwiseMin(vertex(i));
    high = high.cwiseMax(vertex(i));
  }
  SolidIntegrals solid(0.5 * (low + high));
  for (std::size_t k = 0; k < faces.size(); k += 3)
    solid.add(vertex(faces[k]), vertex(faces[k + 1]), vertex(faces[k + 2]));
  const double rounding = 1e-13 * std::pow((high - low).maxCoeff(), 3);
  if (!(std::abs(solid.volume()) > rounding))
    throw InputError("vertices: the mesh has no volume or is not finite");
  if (solid.volume() < 0)
    throw InputError("faces: the mesh is inside out: turn the faces, [i, j, k] into [i, k, j]");
  return solid.moments(density);
}

MassMoments moved(const MassMoments& solid, const Pose& pose) {
  return {solid.mass, pose.to_world(solid.centre),
          pose.rotation * solid.inertia * pose.rotation.transpose()};
}

MassMoments sum(std::span<const MassMoments> parts) {
  MassMoments all;
  for (const MassMoments& part : parts) {
    all.mass += part.mass;
    all.centre += part.mass * part.centre;
  }
  all.centre /= all.mass;
  for (const MassMoments& part : parts) {
    const Vec3 r = part.centre - all.centre;
    all.inertia +=
        part.inertia + part.mass * (r.squaredNorm() * Mat3::Identity() - r * r.transpose());
  }
  return all;
}

MassMoments moments(std::span<const Fixture> fixtures) {
  std::vector<MassMoments> parts;
  for (const Fixture& fixture : fixtures) {
    parts.push_back(moved(moments(fixture.shape, fixture.density), fixture.local));
  }
  return sum(parts);
}

namespace {

// A = V diag(A') V^T by Jacobi's rotations (Golub and Van Loan 2013, "Matrix computations",
// algorithm 8.5.2, cyclic). Entries below the rounding of A stay: they have no direction.
Mat3 diagonalise(Mat3& A) {
  const double rounding = 1e-14 * A.trace();
  Mat3 V = Mat3::Identity();
  for (int sweep = 0; sweep < 20; ++sweep) {
    bool done = true;
    for (int p = 0; p < 2; ++p)
      for (int q = p + 1; q < 3; ++q) {
        if (std::abs(A(p, q)) <= rounding) continue;
        done = false;
        const double tau = (A(q, q) - A(p, p)) / (2 * A(p, q));
        const double t = std::copysign(1, tau) / (std::abs(tau) + std::sqrt(1 + tau * tau));
        const double c = 1 / std::sqrt(1 + t * t), s = t * c;
        Mat3 J = Mat3::Identity();
        J(p, p) = J(q, q) = c, J(p, q) = s, J(q, p) = -s;
        A = J.transpose() * A * J;
        V = V * J;
      }
    if (done) break;
  }
  return V;
}

}  // namespace

void check_principal_moments(const Vec3& inertia, const char* name) {
  std::ostringstream text;
  text << name << ": expected principal moments ";
  if (!(inertia.minCoeff() > 0) || !inertia.allFinite()) {
    text << "that are finite and above 0";
  } else if (2 * inertia.maxCoeff() > inertia.sum() * (1 + 1e-9)) {
    text << "none of which is greater than the sum of the other two";
  } else {
    return;
  }
  text << ", got " << inertia.transpose();
  throw InputError(text.str());
}

MassProperties principal(const MassMoments& solid) {
  Expect{}.positive("mass", solid.mass);
  if (!solid.centre.allFinite()) throw InputError("centre: expected finite numbers");
  const Mat3& I = solid.inertia;
  if (!((I - I.transpose()).lpNorm<Eigen::Infinity>() <= 1e-9 * I.lpNorm<Eigen::Infinity>()))
    throw InputError("inertia: expected a symmetric matrix of finite numbers");
  Mat3 A = 0.5 * (I + I.transpose());
  const Mat3 V = diagonalise(A);

  // Nearest to the frame: the greatest trace. The margin lets the first of equal ones win.
  constexpr int kOrders[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
  Mat3 nearest = Mat3::Identity();
  Vec3 inertia = Vec3::Zero();
  double most = -4;
  for (const auto& order : kOrders)
    for (int signs = 0; signs < 8; ++signs) {
      Mat3 R;
      for (int j = 0; j < 3; ++j) R.col(j) = (signs >> j & 1 ? -1 : 1) * V.col(order[j]);
      if (R.trace() <= most + 1e-9 || R.determinant() < 0) continue;
      most = R.trace();
      nearest = R;
      for (int j = 0; j < 3; ++j) inertia[j] = A(order[j], order[j]);
    }
  check_principal_moments(inertia, "inertia");
  return {solid.mass, solid.centre, Quaternion(nearest).normalized(), inertia};
}

}  // namespace substep::rigid
