#include "substep/geometry/height_field.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "substep/core/errors.h"
#include "substep/geometry/closest_points.h"

namespace substep::geometry {
namespace {

using Vec2 = Eigen::Vector2d;
using Mat2 = Eigen::Matrix2d;

struct Descent {
  Vec2 at;
  bool fixed[2];  // held by the border along this axis
};

// Newton's method for the least phi(u) = (|u - (x, y)|^2 + (H(u) - z)^2) / 2 in the rectangle:
//   grad phi = u - (x, y) + (H - z) grad H,   hess phi = 1 + grad H grad H^T + (H - z) hess H.
template <class Surface>
Descent descend(const Surface& patch, const Vec2& lengths, double spacing, const Vec3& x,
                const Vec2& start) {
  constexpr int kMost = 50;
  constexpr double kSure = 1e-3, kDone = 1e-13;  // spacings: of steps that are not tried, and last
  const auto clamped = [&](const Vec2& u) { return Vec2(u.cwiseMax(0.0).cwiseMin(lengths)); };
  const Vec2 over = x.head<2>();
  const auto phi = [&](const Vec2& u, double height) {
    return 0.5 * ((u - over).squaredNorm() + (height - x[2]) * (height - x[2]));
  };
  Descent found{clamped(start), {false, false}};
  auto here = patch(found.at);
  for (int iteration = 0; iteration < kMost; ++iteration) {
    const double gap = here.height - x[2];
    Vec2 g = found.at - over + gap * here.slope;
    const Mat2 convex = Mat2::Identity() + here.slope * here.slope.transpose();
    Mat2 h = convex + gap * here.bend;
    if (!(h(0, 0) > 0) || !(h.determinant() > 0)) h = convex;
    for (int d = 0; d < 2; ++d) {
      found.fixed[d] = (found.at[d] <= 0 && g[d] > 0) || (found.at[d] >= lengths[d] && g[d] < 0);
      if (!found.fixed[d]) continue;
      g[d] = 0;
      h.row(d).setZero(), h.col(d).setZero();
      h(d, d) = 1;
    }
    const Vec2 step = -(h.inverse() * g);
    const double length = step.norm();
    if (!(length > kDone * spacing)) break;
    const double value = phi(found.at, here.height);
    bool lower = false;
    for (double s = 1; !lower && s > 1e-6; s /= 2) {
      const Vec2 u = clamped(found.at + s * step);
      const auto there = patch(u);
      lower = phi(u, there.height) < value || length < kSure * spacing;
      if (lower) found.at = u, here = there;
    }
    if (!lower) break;
  }
  return found;
}

}  // namespace

HeightField::HeightField(std::array<std::int64_t, 2> shape, const Vec3& origin, double spacing,
                         std::vector<double> heights)
    : shape_(shape), origin_(origin), spacing_(spacing), heights_(std::move(heights)) {
  check();
  for (int d = 0; d < 2; ++d) lengths_[d] = spacing * static_cast<double>(shape[usize(d)] - 1);
  nodes_.reserve(heights_.size());
  for (std::int64_t i = 0; i < shape_[0]; ++i) {
    for (std::int64_t j = 0; j < shape_[1]; ++j) {
      nodes_.push_back(
          patch(spacing * Vec2(static_cast<double>(i), static_cast<double>(j))).height);
    }
  }
  build_levels();
}

void HeightField::check() const {
  if (!(spacing_ > 0) || !std::isfinite(spacing_))
    throw InputError("spacing: expected a number above 0, got " + std::to_string(spacing_));
  const auto [nx, ny] = shape_;
  if (nx < 2 || ny < 2) throw InputError("heights: expected at least 2 along each axis");
  if (heights_.size() != usize(nx * ny))
    throw InputError("heights: their number is not that of the grid's nodes");
  for (std::int64_t i = 0; i < nx; ++i) {
    for (std::int64_t j = 0; j < ny; ++j) {
      const double here = heights_[usize(i * ny + j)];
      const auto differs = [&](std::int64_t a, std::int64_t b) {
        return std::abs(heights_[usize(a * ny + b)] - here) > kSteepest * spacing_;
      };
      const auto place = "heights[" + std::to_string(i) + ", " + std::to_string(j) + "]";
      if (!std::isfinite(here)) throw InputError(place + ": expected a finite number");
      if ((i + 1 < nx && differs(i + 1, j)) || (j + 1 < ny && differs(i, j + 1)))
        throw InputError(place + ": a neighbour differs by more than 1000 times the spacing");
    }
  }
}

// The surface bulges out of the triangles between its nodes by at most
// s^2/8 (|H_xx| + 2 |H_xy| + |H_yy|), and s^2 times these derivatives are means of second
// differences of the heights. Where that is a bound of little use, on ground that turns by more
// than a right angle within a cell, part of it is enough in practice.
void HeightField::build_levels() {
  constexpr double kMostBulge = 0.5;  // spacings
  const auto bulge = [&](std::int64_t i, std::int64_t j) {
    double xx = 0, xy = 0, yy = 0;
    for (std::int64_t a = 0; a < 2; ++a) {
      for (std::int64_t b = -1; b < 3; ++b) {
        const auto along = [&](std::int64_t k) { return ghost(i + k, j + b); };
        const auto across = [&](std::int64_t k) { return ghost(i + b, j + k); };
        xx = std::max(xx, std::abs(along(a - 1) - 2 * along(a) + along(a + 1)));
        yy = std::max(yy, std::abs(across(a - 1) - 2 * across(a) + across(a + 1)));
      }
    }
    for (std::int64_t a = i - 1; a < i + 2; ++a) {
      for (std::int64_t b = j - 1; b < j + 2; ++b) {
        const double twist = ghost(a, b) - ghost(a + 1, b) - ghost(a, b + 1) + ghost(a + 1, b + 1);
        xy = std::max(xy, std::abs(twist));
      }
    }
    return std::min((xx + 2 * xy + yy) / 8, kMostBulge * spacing_);
  };
  Level cells{shape_[0] - 1, shape_[1] - 1, {}};
  for (std::int64_t i = 0; i < cells.nx; ++i) {
    for (std::int64_t j = 0; j < cells.ny; ++j) {
      const auto [low, high] =
          std::minmax({node(i, j), node(i + 1, j), node(i, j + 1), node(i + 1, j + 1)});
      const double more = bulge(i, j);
      cells.ranges.push_back({low - more, high + more});
    }
  }
  levels_.push_back(std::move(cells));
  while (levels_.back().nx > 1 || levels_.back().ny > 1) {
    const Level& fine = levels_.back();
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    Level coarse{(fine.nx + 1) / 2, (fine.ny + 1) / 2, {}};
    coarse.ranges.assign(usize(coarse.nx * coarse.ny), {kInfinity, -kInfinity});
    for (std::int64_t i = 0; i < fine.nx; ++i) {
      for (std::int64_t j = 0; j < fine.ny; ++j) {
        const Range& part = fine.ranges[usize(i * fine.ny + j)];
        Range& all = coarse.ranges[usize(i / 2 * coarse.ny + j / 2)];
        all = {std::min(all.low, part.low), std::max(all.high, part.high)};
      }
    }
    levels_.push_back(std::move(coarse));
  }
}

// A height, or one that a straight line continues beyond the border.
double HeightField::ghost(std::int64_t i, std::int64_t j) const {
  if (i < 0) return 2 * ghost(0, j) - ghost(1, j);
  if (i >= shape_[0]) return 2 * ghost(shape_[0] - 1, j) - ghost(shape_[0] - 2, j);
  if (j < 0) return 2 * ghost(i, 0) - ghost(i, 1);
  if (j >= shape_[1]) return 2 * ghost(i, shape_[1] - 1) - ghost(i, shape_[1] - 2);
  return heights_[usize(i * shape_[1] + j)];
}

std::int64_t HeightField::cell(const Vec2& at, int axis) const {
  const double q = at[axis] / spacing_;
  const double last = static_cast<double>(shape_[usize(axis)] - 2);
  return static_cast<std::int64_t>(q >= 0 ? std::min(std::floor(q), last) : 0.0);  // 0 of NaN
}

HeightField::Patch HeightField::patch(const Vec2& at) const {
  const std::int64_t first[2] = {cell(at, 0), cell(at, 1)};
  double weight[2][4], slope[2][4], bend[2][4];
  for (int d = 0; d < 2; ++d) {
    const double t = at[d] / spacing_ - static_cast<double>(first[d]), r = 1 - t;
    const double b[4] = {r * r * r / 6, (3 * t * t * t - 6 * t * t + 4) / 6,
                         (3 * r * r * r - 6 * r * r + 4) / 6, t * t * t / 6};
    const double db[4] = {-r * r / 2, (3 * t * t - 4 * t) / 2, (4 * r - 3 * r * r) / 2, t * t / 2};
    const double ddb[4] = {r, 3 * t - 2, 3 * r - 2, t};
    for (int k = 0; k < 4; ++k) {
      weight[d][k] = b[k];
      slope[d][k] = db[k] / spacing_;
      bend[d][k] = ddb[k] / (spacing_ * spacing_);
    }
  }
  const bool within = first[0] > 0 && first[0] < shape_[0] - 2 && first[1] > 0 &&
                      first[1] < shape_[1] - 2;  // all 16 nodes are there
  Patch sum{0, Vec2::Zero(), Mat2::Zero()};
  for (int a = 0; a < 4; ++a) {
    double value = 0, along = 0, curved = 0;
    const std::int64_t i = first[0] - 1 + a;
    for (int b = 0; b < 4; ++b) {
      const std::int64_t j = first[1] - 1 + b;
      const double h = within ? heights_[usize(i * shape_[1] + j)] : ghost(i, j);
      value += weight[1][b] * h;
      along += slope[1][b] * h;
      curved += bend[1][b] * h;
    }
    sum.height += weight[0][a] * value;
    sum.slope += Vec2(slope[0][a] * value, weight[0][a] * along);
    sum.bend(0, 0) += bend[0][a] * value;
    sum.bend(0, 1) += slope[0][a] * along;
    sum.bend(1, 1) += weight[0][a] * curved;
  }
  sum.bend(1, 0) = sum.bend(0, 1);
  return sum;
}

// Of x to the box about a block.
double HeightField::distance2(std::size_t level, std::int64_t i, std::int64_t j,
                              const Vec3& x) const {
  const Level& blocks = levels_[level];
  const auto [low, high] = blocks.ranges[usize(i * blocks.ny + j)];
  const double side = std::ldexp(spacing_, static_cast<int>(level));
  const Vec2 corner = side * Vec2(static_cast<double>(i), static_cast<double>(j));
  const Vec2 end = (corner + Vec2::Constant(side)).cwiseMin(lengths_);
  const Vec3 nearest =
      x.cwiseMax(Vec3(corner[0], corner[1], low)).cwiseMin(Vec3(end[0], end[1], high));
  return (x - nearest).squaredNorm();
}

// Lowers `best` to the nearest point of the surface that is found from a block.
void HeightField::search(std::size_t level, std::int64_t i, std::int64_t j, const Vec3& x,
                         Start& best) const {
  if (level == 0) {
    const auto corner = [&](std::int64_t a, std::int64_t b) {
      return Vec3(spacing_ * static_cast<double>(a), spacing_ * static_cast<double>(b), node(a, b));
    };
    const Vec3 a = corner(i, j), b = corner(i + 1, j), c = corner(i + 1, j + 1),
               d = corner(i, j + 1);
    Start near{std::numeric_limits<double>::infinity(), Vec2::Zero()};
    for (const Vec3& side : {b, d}) {
      const auto [u, v, w] = closest_on_triangle(x, a, side, c);
      const Vec3 point = u * a + v * side + w * c;
      const double d2 = (x - point).squaredNorm();
      if (d2 < near.distance2) near = {d2, point.head<2>()};
    }
    const double bulge =
        levels_[0].ranges[usize(i * levels_[0].ny + j)].high - std::max({a[2], b[2], c[2], d[2]});
    if (!(std::sqrt(near.distance2) < std::sqrt(best.distance2) + bulge)) return;
    const auto surface = [&](const Vec2& at) { return patch(at); };
    const Vec2 at = descend(surface, lengths_, spacing_, x, near.at).at;
    const double d2 = (x - Vec3(at[0], at[1], patch(at).height)).squaredNorm();
    if (d2 < best.distance2) best = {d2, at};
    return;
  }
  struct Child {
    double distance2;
    std::int64_t i, j;
  };
  Child children[4];
  int count = 0;
  const Level& fine = levels_[level - 1];
  for (std::int64_t a = 2 * i; a < std::min(2 * i + 2, fine.nx); ++a) {
    for (std::int64_t b = 2 * j; b < std::min(2 * j + 2, fine.ny); ++b) {
      Child child{distance2(level - 1, a, b, x), a, b};
      for (int k = 0; k < count; ++k) {
        if (child.distance2 < children[k].distance2) std::swap(child, children[k]);
      }
      children[count++] = child;
    }
  }
  for (int k = 0; k < count && children[k].distance2 < best.distance2; ++k) {
    search(level - 1, children[k].i, children[k].j, x, best);
  }
}

HeightField::Foot HeightField::foot(const Vec3& x) const {
  Start best{std::numeric_limits<double>::infinity(), clamped(x.head<2>())};
  search(0, cell(best.at, 0), cell(best.at, 1), x, best);
  search(levels_.size() - 1, 0, 0, x, best);
  const auto surface = [&](const Vec2& at) { return patch(at); };
  const Descent found = descend(surface, lengths_, spacing_, x, best.at);
  return {found.at, patch(found.at), {found.fixed[0], found.fixed[1]}};
}

HeightField::Nearest HeightField::nearest(const Vec3& x) const {
  const Vec2 c = clamped(x.head<2>()), beyond = x.head<2>() - c;
  const bool beside = !beyond.isZero(0), below = x[2] < patch(c).height;
  if (beside && below) {
    const double d = beyond.norm();
    return {{d, Vec3(beyond[0] / d, beyond[1] / d, 0)}, Part::kSide, {}};
  }
  const Foot foot = this->foot(x);
  const Vec2& slope = foot.patch.slope;
  const Vec3 n = Vec3(-slope[0], -slope[1], 1).normalized();
  const Vec3 arm = x - Vec3(foot.at[0], foot.at[1], foot.patch.height);
  Nearest found{{n.dot(arm), n}, Part::kSurface, foot};
  if ((foot.fixed[0] || foot.fixed[1]) && !arm.isZero(0)) {
    const double d = (below ? -1 : 1) * arm.norm();
    found.distance = {d, arm / d};
    found.part = Part::kEdge;
  }
  if (!below) return found;
  for (int d = 0; d < 2; ++d) {
    for (const double sign : {-1.0, 1.0}) {
      const double side = sign > 0 ? x[d] - lengths_[d] : -x[d];
      if (side <= found.distance.value) continue;
      found.distance = {side, sign * Vec3::Unit(d)};
      found.part = Part::kSide;
    }
  }
  return found;
}

SignedDistance HeightField::signed_distance(const Vec3& x) const {
  return nearest(x - origin_).distance;
}

// Near the surface, with n its normal and P = 1 - n n^T: K / (1 + d K), where K = -n_z P hess H P
// is that on it. Near its border as about a curve with the tangent t: (P - t t^T) / d - k / (1 - d
// k) t t^T, where k = n_z H_tt / (1 + H_t^2) is how much it turns towards n; or about a point: P /
// d. The sides are flat and meet in upright edges.
Mat3 HeightField::hessian(const Vec3& x) const {
  const auto [distance, part, foot] = nearest(x - origin_);
  const Vec3& n = distance.gradient;
  const Mat3 tangential = Mat3::Identity() - n * n.transpose();
  if (part == Part::kSide) {
    if (n[0] == 0 || n[1] == 0) return Mat3::Zero();
    return (tangential - Mat3(Vec3::UnitZ().asDiagonal())) / distance.value;
  }
  if (part == Part::kEdge) {
    Mat3 edge = tangential / distance.value;
    for (int axis = 0; axis < 2; ++axis) {
      if (foot.fixed[axis]) continue;
      const double slope = foot.patch.slope[axis];
      const double k = n[2] * foot.patch.bend(axis, axis) / (1 + slope * slope);
      const Vec3 t = (Vec3::Unit(axis) + slope * Vec3::UnitZ()).normalized();
      edge -= (1 / distance.value + k / (1 - distance.value * k)) * t * t.transpose();
    }
    return edge;
  }
  Mat3 bend = Mat3::Zero();
  bend.topLeftCorner<2, 2>() = foot.patch.bend;
  const Mat3 curvature = -n[2] * tangential * bend * tangential;
  return curvature * (Mat3::Identity() + distance.value * curvature).inverse();
}

}  // namespace substep::geometry
