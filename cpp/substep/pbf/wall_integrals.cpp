#include "substep/pbf/wall_integrals.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace substep::pbf {
namespace {

using std::numbers::pi;

constexpr int kDistances = 1024;    // cells of a table over [-h, h]
constexpr std::size_t kCells = 32;  // of the corners' table along an axis
constexpr std::size_t kHalves = 2;  // cells of integration in one of the table
constexpr std::size_t kNodes = kCells + 1;

// f of the file's comment.
double share(double r, double d, double radius, int dimension) {
  double c = d / r;
  if (std::isfinite(radius)) {
    const double D = std::max(radius + d, 1e-12 * radius);  // the centre: c does not matter there
    c = (D * D + r * r - radius * radius) / (2 * D * r);
  }
  c = std::clamp(c, -1.0, 1.0);
  return dimension == 2 ? std::acos(c) / pi : 0.5 * (1 - c);
}

// b(d): what is nearer than |d| lies outside for d > 0 and inside for d < 0.
double integral(const KernelFunction& kernel, double h, int dimension, double radius, double d) {
  constexpr int kShells = 256;
  const double near = std::abs(d), step = (h - near) / kShells;
  double sum = 0;
  for (int k = 0; k < kShells; ++k) {
    const double r = near + step * (k + 0.5);
    const double area = dimension == 2 ? 2 * pi * r : 4 * pi * r * r;
    const double f = share(r, d, radius, dimension);
    sum += kernel(r) * area * (d < 0 ? 1 - f : f);
  }
  return d < 0 ? 1 - step * sum : step * sum;
}

}  // namespace

DistanceTable::DistanceTable(const KernelFunction& kernel, double h, int dimension, double radius)
    : h_(h), entries_(kDistances + 1) {
  const double step = 2 * h / kDistances;
  for (int k = 0; k <= kDistances; ++k) {
    const double d = std::max(-h + step * k, -radius);
    entries_[static_cast<std::size_t>(k)].value = integral(kernel, h, dimension, radius, d);
  }
  for (std::size_t k = 0; k <= kDistances; ++k) {
    const std::size_t low = k > 0 ? k - 1 : 0, high = std::min<std::size_t>(k + 1, kDistances);
    entries_[k].slope =
        (entries_[high].value - entries_[low].value) / (step * static_cast<double>(high - low));
  }
  entries_.back() = {0, 0};
}

auto DistanceTable::operator()(double d) const -> Entry {
  const double at = (d / h_ + 1) * (kDistances / 2);
  if (!(at < kDistances)) return {0, 0};
  if (at <= 0) return {entries_.front().value, 0};
  const auto k = static_cast<std::size_t>(at);
  const double t = at - static_cast<double>(k);
  const Entry &a = entries_[k], &b = entries_[k + 1];
  return {a.value + t * (b.value - a.value), a.slope + t * (b.slope - a.slope)};
}

// Sums over cells of W at their centres, from the far end on; derivatives are sums over a plane.
CornerTable::CornerTable(const KernelFunction& kernel, double h, int dimension)
    : h_(h), dimension_(dimension) {
  const std::size_t deep = dimension == 2 ? 1 : kNodes;
  nodes_.assign(kNodes * kNodes * deep, Node{0, 0});
  const double step = h / static_cast<double>(kCells * kHalves);
  const std::size_t fine = kCells * kHalves, fine_deep = dimension == 2 ? 1 : fine;
  // Integrals over y and z of W(x, y, z) beyond (j, k), for one x.
  const auto plane = [&](double x) {
    std::vector<double> sums((fine + 1) * (fine_deep + 1), 0.0);
    for (std::size_t j = fine; j-- > 0;) {
      double row = 0;
      for (std::size_t k = fine_deep; k-- > 0;) {
        const double y = step * (static_cast<double>(j) + 0.5);
        const double z = dimension == 2 ? 0 : step * (static_cast<double>(k) + 0.5);
        const double r = std::sqrt(x * x + y * y + z * z);
        row += (r < h ? kernel(r) : 0) * (dimension == 2 ? step / 2 : step * step);
        sums[j * (fine_deep + 1) + k] = sums[(j + 1) * (fine_deep + 1) + k] + row;
      }
    }
    return sums;
  };
  const auto put = [&](std::size_t i, const std::vector<double>& sums, auto&& set) {
    for (std::size_t j = 0; j < kNodes; ++j) {
      for (std::size_t k = 0; k < deep; ++k) {
        set(nodes_[(i * kNodes + j) * deep + k],
            sums[j * kHalves * (fine_deep + 1) + (dimension == 2 ? 0 : k * kHalves)]);
      }
    }
  };
  std::vector<double> total((fine + 1) * (fine_deep + 1), 0.0);
  for (std::size_t i = kNodes; i-- > 0;) {
    put(i, total, [](Node& node, double sum) { node.value = sum; });
    put(i, plane(h * static_cast<double>(i) / kCells),
        [](Node& node, double sum) { node.by_x = -sum; });
    for (std::size_t half = 0; half < kHalves && i > 0; ++half) {
      const double x =
          h * static_cast<double>(i) / kCells - step * (static_cast<double>(half) + 0.5);
      const std::vector<double> slice = plane(x);
      for (std::size_t k = 0; k < total.size(); ++k) total[k] += step * slice[k];
    }
  }
  // An eighth of the kernel must lie beyond (0, 0, 0), whatever the rule of integration.
  const double all = 8 * nodes_[0].value;
  for (Node& node : nodes_) node.value /= all, node.by_x /= all;
}

auto CornerTable::node(std::size_t i, std::size_t j, std::size_t k) const -> const Node& {
  return dimension_ == 2 ? nodes_[i * kNodes + j] : nodes_[(i * kNodes + j) * kNodes + k];
}

auto CornerTable::octant(const Vec3& from) const -> Octant {
  std::size_t at[3] = {};
  double weight[3][2] = {};
  for (int axis = 0; axis < 3; ++axis) {
    const double q = from[axis] / h_ * kCells;
    if (!(q < kCells)) return {};
    at[axis] = static_cast<std::size_t>(q);
    weight[axis][1] = q - static_cast<double>(at[axis]);
    weight[axis][0] = 1 - weight[axis][1];
  }
  Octant sum{};
  for (std::size_t a = 0; a < 2; ++a) {
    for (std::size_t b = 0; b < 2; ++b) {
      for (std::size_t c = 0; c < 2; ++c) {
        const double w = weight[0][a] * weight[1][b] * weight[2][c];
        if (w == 0) continue;
        const std::size_t i = at[0] + a, j = at[1] + b, k = at[2] + c;
        sum[0] += w * node(i, j, k).value;
        sum[1] += w * node(i, j, k).by_x;
        sum[2] += w * node(j, i, k).by_x;
        if (dimension_ == 3) sum[3] += w * node(k, j, i).by_x;
      }
    }
  }
  return sum;
}

WallDensity CornerTable::box(const Vec3& low, const Vec3& high) const {
  // Each side as a sum of octants beyond coordinates >= 0: factor, coordinate, and the derivative
  // of that by the coordinate of the side (0 where the octant begins at -inf).
  struct Term {
    double factor, from, derivative;
  };
  struct Terms {
    std::array<Term, 4> list;
    int count = 0;

    void add(double sign, double side, double h) {
      if (side >= h) return;
      if (side < 0) list[static_cast<std::size_t>(count++)] = {2 * sign, 0, 0};
      if (side > 0 && side < h) list[static_cast<std::size_t>(count++)] = {sign, side, 1};
      if (side < 0 && side > -h) list[static_cast<std::size_t>(count++)] = {-sign, -side, -1};
      if (side == 0) list[static_cast<std::size_t>(count++)] = {sign, 0, 1};
    }
  };
  std::array<Terms, 3> terms;
  for (int axis = 0; axis < 3; ++axis) {
    Terms& of = terms[static_cast<std::size_t>(axis)];
    if (axis == 2 && dimension_ == 2) {
      of.list[0] = {2, 0, 0};
      of.count = 1;
      continue;
    }
    of.add(1, low[axis], h_);
    of.add(-1, high[axis], h_);
  }
  WallDensity result;
  const auto each = [](const Terms& of, auto&& visit) {
    for (int t = 0; t < of.count; ++t) visit(of.list[static_cast<std::size_t>(t)]);
  };
  each(terms[0], [&](const Term& x) {
    each(terms[1], [&](const Term& y) {
      each(terms[2], [&](const Term& z) {
        const double factor = x.factor * y.factor * z.factor;
        const Octant o = octant({x.from, y.from, z.from});
        result.value += factor * o[0];
        // Sides move by minus the particle.
        result.gradient -=
            factor * Vec3(x.derivative * o[1], y.derivative * o[2], z.derivative * o[3]);
      });
    });
  });
  return result;
}

}  // namespace substep::pbf
