#include "substep/pbf/wall_integrals.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "substep/core/usize.h"

namespace substep::pbf {
namespace {

using std::numbers::pi;

constexpr int kDistances = 1024;        // cells of a table over [-h, h]
constexpr std::size_t kMirrored = 512;  // cells of the mirror's table
constexpr std::size_t kCells = 32;      // of the corners' table along an axis
constexpr std::size_t kHalves = 2;      // cells of integration in one of the table
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
    entries_[usize(k)].value = integral(kernel, h, dimension, radius, d);
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
  const auto k = usize(at);
  const double t = at - static_cast<double>(k);
  const Entry &a = entries_[k], &b = entries_[k + 1];
  return {a.value + t * (b.value - a.value), a.slope + t * (b.slope - a.slope)};
}

Mirror::Mirror(const DistanceTable& plane, double h, double spacing, double half_lattice)
    : reach_(h / 2), h_(h), entries_(kMirrored + 1) {
  const double step = reach_ / kMirrored;
  const auto layers = [&](double s) {
    double sum = 0;
    for (double z = 2 * s; z < h; z += spacing) sum -= spacing * plane(z).slope;
    return sum;
  };
  const double scale = half_lattice / layers(spacing / 2);
  // b falls from 1 to 0: where it is m is found by halving.
  const auto distance = [&](double value) {
    double low = -h, high = h;
    for (int halving = 0; halving < 60; ++halving) {
      const double middle = 0.5 * (low + high);
      (plane(middle).value > value ? low : high) = middle;
    }
    return high;
  };
  for (std::size_t k = 0; k <= kMirrored; ++k) {
    const double m = std::min(scale * layers(step * static_cast<double>(k)), 1.0);
    entries_[k].value = m;
    entries_[k].distance = m > 0 ? distance(m) : h;
  }
  for (std::size_t k = 0; k <= kMirrored; ++k) {
    const std::size_t low = k > 0 ? k - 1 : 0, high = std::min<std::size_t>(k + 1, kMirrored);
    const double width = step * static_cast<double>(high - low);
    entries_[k].slope = (entries_[high].value - entries_[low].value) / width;
    entries_[k].stretch = (entries_[high].distance - entries_[low].distance) / width;
  }
}

auto Mirror::operator()(double s) const -> Entry {
  if (!(s < reach_)) return {0, 0, h_, 0};
  const double at = std::max(s, 0.0) / reach_ * kMirrored;
  const std::size_t k = std::min<std::size_t>(usize(at), kMirrored - 1);
  const double t = at - static_cast<double>(k);
  const Entry &a = entries_[k], &b = entries_[k + 1];
  const auto between = [&](double low, double high) { return low + t * (high - low); };
  return {between(a.value, b.value), between(a.slope, b.slope), between(a.distance, b.distance),
          between(a.stretch, b.stretch)};
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
    at[axis] = usize(q);
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

auto CornerTable::box(const Vec3& low, const Vec3& high) const -> BoxIntegral {
  // Each side as a sum of octants beyond coordinates >= 0: factor, coordinate, and the derivative
  // of that by the coordinate of the side (0 where the octant begins at -inf).
  struct Term {
    double factor, from, derivative;
    bool upper;
  };
  struct Terms {
    std::array<Term, 4> list;
    std::size_t count = 0;

    void add(bool upper, double side, double h) {
      const double sign = upper ? -1 : 1;
      if (side >= h) return;
      if (side < 0) list[count++] = {2 * sign, 0, 0, upper};
      if (side >= 0) list[count++] = {sign, side, 1, upper};
      if (side < 0 && side > -h) list[count++] = {-sign, -side, -1, upper};
    }
  };
  std::array<Terms, 3> terms;
  for (int axis = 0; axis < 3; ++axis) {
    Terms& of = terms[usize(axis)];
    if (axis == 2 && dimension_ == 2) {
      of.list[of.count++] = {2, 0, 0, false};
      continue;
    }
    of.add(false, low[axis], h_);
    of.add(true, high[axis], h_);
  }
  BoxIntegral result;
  for (std::size_t i = 0; i < terms[0].count; ++i) {
    for (std::size_t j = 0; j < terms[1].count; ++j) {
      for (std::size_t k = 0; k < terms[2].count; ++k) {
        const std::array<const Term*, 3> of = {&terms[0].list[i], &terms[1].list[j],
                                               &terms[2].list[k]};
        const double factor = of[0]->factor * of[1]->factor * of[2]->factor;
        const Octant o = octant({of[0]->from, of[1]->from, of[2]->from});
        result.value += factor * o[0];
        for (int axis = 0; axis < 3; ++axis) {
          const Term& term = *of[usize(axis)];
          const double change = factor * term.derivative * o[usize(axis) + 1];
          (term.upper ? result.by_high : result.by_low)[axis] += change;
        }
      }
    }
  }
  return result;
}

}  // namespace substep::pbf
