#include "substep/pbf/density_map.h"

#include <algorithm>
#include <cmath>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::pbf {
namespace {

constexpr std::int64_t kReach = 8;      // cells of integration in h
constexpr std::int64_t kNodeCells = 2;  // of those between two nodes
constexpr std::int64_t kPlanes = 8;     // of nodes, in a task
constexpr std::int64_t kBorder = 2;     // nodes beyond where b vanishes

// The corners of the box of all nodes with values below 0, a spacing wider.
std::array<Vec3, 2> inside_box(const geometry::SampledDistance& field) {
  const auto [nx, ny, nz] = field.shape();
  Vec3 low = Vec3::Constant(1e300), high = -low;
  for (std::int64_t i = 0; i < nx; ++i) {
    for (std::int64_t j = 0; j < ny; ++j) {
      for (std::int64_t k = 0; k < nz; ++k) {
        if (field.values()[usize((i * ny + j) * nz + k)] >= 0) continue;
        const Vec3 at(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k));
        low = low.cwiseMin(at), high = high.cwiseMax(at);
      }
    }
  }
  if (!(low[0] <= high[0])) return {Vec3::Zero(), Vec3::Zero()};
  const auto place = [&](const Vec3& at, double wider) {
    return Vec3(field.origin() + field.spacing() * (at + Vec3::Constant(wider)));
  };
  return {place(low, -1), place(high, 1)};
}

}  // namespace

DensityMap::DensityMap(const geometry::SampledDistance& field, bool hollow,
                       const KernelFunction& kernel, double h, int threads)
    : spacing_(h * kNodeCells / kReach), hollow_(hollow) {
  const auto [low, high] = inside_box(field);
  const double border = h + kBorder * spacing_;
  origin_ = low - Vec3::Constant(border);
  double count = 1;
  for (int axis = 0; axis < 3; ++axis) {
    const double nodes = std::ceil((high[axis] - low[axis] + 2 * border) / spacing_) + 1;
    shape_[usize(axis)] = static_cast<std::int64_t>(nodes);
    count *= nodes;
  }
  if (!(count <= static_cast<double>(kMaxNodes)))
    throw InputError("colliders: the map of a signed distance field would have " +
                     std::to_string(count) + " nodes; the particles are too small for it");
  nodes_.assign(usize(count), 0.0f);
  sample(field, kernel, h, threads);
  sharpen();
}

// b at the nodes: a weighted sum over the cells about each. Tasks are planes of nodes.
void DensityMap::sample(const geometry::SampledDistance& field, const KernelFunction& kernel,
                        double h, int threads) {
  const double cell = h / kReach;
  // Cell (a, b, c) about a node: its centre is (a + 1/2, ...) cells away, a = -kReach .. kReach
  // - 1.
  constexpr std::int64_t kWidth = 2 * kReach;
  std::vector<float> weights(kWidth * kWidth * kWidth);
  double total = 0;
  const auto weight = [&](std::int64_t a, std::int64_t b, std::int64_t c) -> float& {
    return weights[usize((a * kWidth + b) * kWidth + c)];
  };
  const auto offset = [&](std::int64_t a) {
    return cell * (static_cast<double>(a - kReach) + 0.5);
  };
  for (std::int64_t a = 0; a < kWidth; ++a) {
    for (std::int64_t b = 0; b < kWidth; ++b) {
      for (std::int64_t c = 0; c < kWidth; ++c) {
        const double r = Vec3(offset(a), offset(b), offset(c)).norm();
        const double w = r < h ? kernel(r) : 0.0;
        weight(a, b, c) = static_cast<float>(w);
        total += w;
      }
    }
  }
  for (float& w : weights) w = static_cast<float>(w / total);

  const auto [nx, ny, nz] = shape_;
  const std::int64_t width_y = kNodeCells * ny + kWidth, width_z = kNodeCells * nz + kWidth;
  const auto cell_at = [&](std::int64_t a) {  // coordinate of cell a from the origin on
    return cell * (static_cast<double>(a - kReach) + 0.5);
  };
  const auto planes = [&, ny = ny, nz = nz](std::int64_t begin, std::int64_t end) {
    const std::int64_t width_x = kNodeCells * (end - begin - 1) + kWidth;
    std::vector<float> shares(usize(width_x * width_y * width_z));
    for (std::int64_t a = 0; a < width_x; ++a) {
      for (std::int64_t b = 0; b < width_y; ++b) {
        float* row = &shares[usize((a * width_y + b) * width_z)];
        for (std::int64_t c = 0; c < width_z;) {
          const Vec3 at(cell_at(kNodeCells * begin + a), cell_at(b), cell_at(c));
          const double d = field.signed_distance(origin_ + at).value;
          // The share does not change while the surface is out of reach.
          const double alike = (std::abs(d) / field.lipschitz(d < 0)) / cell;
          const auto count = std::max<std::int64_t>(static_cast<std::int64_t>(alike), 1);
          const std::int64_t next = std::min(width_z, c + count);
          std::fill(row + c, row + next, static_cast<float>(std::clamp(0.5 - d / cell, 0.0, 1.0)));
          c = next;
        }
      }
    }
    const auto sum_about = [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      float sum = 0;
      for (std::int64_t a = 0; a < kWidth; ++a) {
        for (std::int64_t b = 0; b < kWidth; ++b) {
          const std::int64_t column = (kNodeCells * (i - begin) + a) * width_y + kNodeCells * j + b;
          const float* row = &shares[usize(column * width_z + kNodeCells * k)];
          const float* by = &weights[usize((a * kWidth + b) * kWidth)];
          float part[kWidth];
          for (std::int64_t c = 0; c < kWidth; ++c) part[c] = by[c] * row[c];
          for (std::int64_t half = kWidth / 2; half > 0; half /= 2) {
            for (std::int64_t c = 0; c < half; ++c) part[c] += part[c + half];
          }
          sum += part[0];
        }
      }
      return sum;
    };
    for (std::int64_t i = begin; i < end; ++i) {
      poll_interrupt();
      for (std::int64_t j = 0; j < ny; ++j) {
        for (std::int64_t k = 0; k < nz; ++k) {
          const Vec3 at(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k));
          const double d = field.signed_distance(origin_ + spacing_ * at).value;
          const bool near = std::abs(d) < 1.1 * h * field.lipschitz(d < 0);
          nodes_[usize((i * ny + j) * nz + k)] = near ? sum_about(i, j, k) : (d < 0 ? 1.0f : 0.0f);
        }
      }
    }
  };
  parallel_for(nx, kPlanes, planes, threads);
}

// From values to the coefficients of the spline.
void DensityMap::sharpen() {
  const std::vector<float> values = nodes_;
  const std::int64_t stride_x = shape_[1] * shape_[2], stride_y = shape_[2];
  for (std::int64_t i = 1; i + 1 < shape_[0]; ++i) {
    for (std::int64_t j = 1; j + 1 < shape_[1]; ++j) {
      for (std::int64_t k = 1; k + 1 < shape_[2]; ++k) {
        const std::int64_t n = i * stride_x + j * stride_y + k;
        const auto value = [&](std::int64_t m) { return values[usize(m)]; };
        nodes_[usize(n)] =
            value(n) - (value(n - stride_x) + value(n + stride_x) + value(n - stride_y) +
                        value(n + stride_y) + value(n - 1) + value(n + 1) - 6 * value(n)) /
                           8;
      }
    }
  }
}

WallDensity DensityMap::operator()(const Vec3& x) const {
  WallDensity result;
  result.value = hollow_ ? 1 : 0;
  std::int64_t first[3];
  double weight[3][3], slope[3][3];
  for (int axis = 0; axis < 3; ++axis) {
    const double q = (x[axis] - origin_[axis]) / spacing_;
    const std::int64_t count = shape_[usize(axis)];
    if (!(q >= 0.5 && q < static_cast<double>(count) - 1.5)) return result;
    const double center = std::floor(q + 0.5), s = q - center;
    first[axis] = static_cast<std::int64_t>(center) - 1;
    weight[axis][0] = 0.5 * (0.5 - s) * (0.5 - s);
    weight[axis][1] = 0.75 - s * s;
    weight[axis][2] = 0.5 * (0.5 + s) * (0.5 + s);
    slope[axis][0] = s - 0.5, slope[axis][1] = -2 * s, slope[axis][2] = s + 0.5;
  }
  double value = 0;
  Vec3 gradient = Vec3::Zero();
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) {
      double along = 0, change = 0;
      for (int c = 0; c < 3; ++c) {
        const double at = static_cast<double>(node(first[0] + a, first[1] + b, first[2] + c));
        along += weight[2][c] * at;
        change += slope[2][c] * at;
      }
      value += weight[0][a] * weight[1][b] * along;
      gradient += Vec3(slope[0][a] * weight[1][b] * along, weight[0][a] * slope[1][b] * along,
                       weight[0][a] * weight[1][b] * change);
    }
  }
  result.value = hollow_ ? 1 - value : value;
  result.gradient = (hollow_ ? -1 : 1) / spacing_ * gradient;
  return result;
}

}  // namespace substep::pbf
