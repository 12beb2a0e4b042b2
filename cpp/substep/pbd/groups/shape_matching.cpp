#include "substep/pbd/groups/shape_matching.h"

#include <algorithm>
#include <bit>
#include <numeric>
#include <utility>

#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

constexpr std::int64_t kBatchesPerChunk = 4;
constexpr double kFlat = 1e-9;  // det / (trace / 3)^3 of sum m q q^T of a flat cluster

}  // namespace

template <class Real>
ShapeMatching<Real>::ShapeMatching(Clusters clusters)
    : clusters_(std::move(clusters)),
      lambda_(clusters_.compliance.size(), 0.0),
      share_(clusters_.stiffness) {}

// Clusters take the first of 64 colours that none of their particles has yet; those that are left
// take the next 64.
template <class Real>
void ShapeMatching<Real>::attach(const Partition& partition) {
  slot_.resize(clusters_.particle.size());
  for (std::size_t k = 0; k < slot_.size(); ++k) {
    slot_[k] = partition.slot[usize(clusters_.particle[k])];
  }
  const auto members = [&](std::int32_t cluster) {
    const auto k = usize(cluster);
    return std::span(slot_).subspan(usize(clusters_.start[k]),
                                    usize(clusters_.start[k + 1] - clusters_.start[k]));
  };
  order_.clear();
  phase_start_.assign(1, 0);
  std::vector<std::int32_t> waiting(lambda_.size());
  std::iota(waiting.begin(), waiting.end(), 0);
  while (!waiting.empty()) {
    std::vector<std::uint64_t> used(partition.slot.size(), 0);
    std::array<std::vector<std::int32_t>, 64> colours;
    std::vector<std::int32_t> left;
    for (const std::int32_t cluster : waiting) {
      std::uint64_t taken = 0;
      for (const std::int32_t s : members(cluster)) taken |= used[usize(s)];
      const int colour = std::countr_one(taken);
      if (colour == 64) {
        left.push_back(cluster);
        continue;
      }
      for (const std::int32_t s : members(cluster)) {
        used[usize(s)] |= std::uint64_t{1} << colour;
      }
      colours[usize(colour)].push_back(cluster);
    }
    for (const auto& list : colours) {
      if (list.empty()) continue;
      order_.insert(order_.end(), list.begin(), list.end());
      phase_start_.push_back(static_cast<std::int64_t>(order_.size()));
    }
    waiting.swap(left);
  }
}

// Plain PBD: 1 - k of the error is left after all projections of a step.
template <class Real>
void ShapeMatching<Real>::begin_step(double /*h*/, int substeps, int iterations) {
  const double n = static_cast<double>(substeps) * iterations;
  for (std::size_t k = 0; k < share_.size(); ++k) {
    const double stiffness = clusters_.stiffness[k];
    share_[k] = stiffness < 1 ? -std::expm1(std::log1p(-stiffness) / n) : 1;
  }
}

template <class Real>
std::int64_t ShapeMatching<Real>::batches(int phase) const {
  const auto f = usize(phase);
  return (phase_start_[f + 1] - phase_start_[f] + kLanes - 1) / kLanes;
}

template <class Real>
std::int64_t ShapeMatching<Real>::chunks(int phase) const {
  return (batches(phase) + kBatchesPerChunk - 1) / kBatchesPerChunk;
}

// Centres, A and T of the clusters of a batch: sums over their particles one cluster after the
// other, decompositions in lanes.
template <class Real>
void ShapeMatching<Real>::match(const Sweep<Real>& sweep, Batch& batch) const {
  Matrix3<V> A{}, Q{};
  batch.centre = batch.rest_centre = {};
  for (int lane = 0; lane < batch.count; ++lane) {
    const auto cluster = usize(batch.cluster[usize(lane)]);
    const auto begin = usize(clusters_.start[cluster]);
    const auto end = usize(clusters_.start[cluster + 1]);
    double free_mass = 0;
    for (std::size_t k = begin; k < end; ++k) {
      const double w = sweep.x[slot_[k]].w;
      if (w > 0) free_mass += 1 / w;
    }
    const double pinned_mass = free_mass;
    batch.pinned_mass[usize(lane)] = pinned_mass;
    if (free_mass == 0) continue;

    // Sums about the first member, so that no digits are lost far from the origin.
    const Point<Real>& x0 = sweep.x[slot_[begin]];
    const std::array<double, 3>& q0 = clusters_.rest[begin];
    double mass = 0, x_sum[3] = {}, q_sum[3] = {}, a[3][3] = {}, b[3][3] = {};
    for (std::size_t k = begin; k < end; ++k) {
      const Point<Real>& p = sweep.x[slot_[k]];
      const double w = p.w, m = w > 0 ? 1 / w : pinned_mass;
      const double x[3] = {double(p.x) - x0.x, double(p.y) - x0.y, double(p.z) - x0.z};
      const std::array<double, 3>& rest = clusters_.rest[k];
      const double q[3] = {rest[0] - q0[0], rest[1] - q0[1], rest[2] - q0[2]};
      mass += m;
      for (int i = 0; i < 3; ++i) {
        x_sum[i] += m * x[i];
        q_sum[i] += m * q[i];
        for (int j = 0; j < 3; ++j) {
          a[i][j] += m * x[i] * q[j];
          b[i][j] += m * q[i] * q[j];
        }
      }
    }
    batch.centre[0][lane] = x0.x + x_sum[0] / mass;
    batch.centre[1][lane] = x0.y + x_sum[1] / mass;
    batch.centre[2][lane] = x0.z + x_sum[2] / mass;
    for (int i = 0; i < 3; ++i) {
      batch.rest_centre[i][lane] = q0[usize(i)] + q_sum[i] / mass;
      for (int j = 0; j < 3; ++j) {
        A(i, j)[lane] = a[i][j] - x_sum[i] * q_sum[j] / mass;
        Q(i, j)[lane] = b[i][j] - q_sum[i] * q_sum[j] / mass;
      }
    }
  }

  const Svd3<V> svd = svd3(A);
  const Matrix3<V> R = svd.U * transpose(svd.V);
  batch.T = R;
  if (clusters_.linear == 0) return;
  const V zero{}, one = zero + 1.0;
  const Matrix3<V> cof = cofactor(Q);  // Q is symmetric: its inverse is cof / det
  const V det_Q = dot(Q.column(0), cof.column(0));
  const V third = (Q(0, 0) + Q(1, 1) + Q(2, 2)) / 3.0;
  const auto solid = det_Q > kFlat * third * third * third;
  const Matrix3<V> B = A * combine<V>(one / (solid ? det_Q : one), cof, zero, cof);
  const V det_B = dot(B.column(0), cross(B.column(1), B.column(2)));
  V scale{};
  for (int lane = 0; lane < kLanes; ++lane) {
    scale[lane] = solid[lane] && det_B[lane] > 0 ? 1 / std::cbrt(det_B[lane]) : 0.0;
  }
  const V beta = scale > zero ? zero + clusters_.linear : zero;
  batch.T = combine<V>(one - beta, R, beta * scale, B);
}

template <class Real>
template <class Visit>
void ShapeMatching<Real>::for_members(const Sweep<Real>& sweep, const Batch& batch, int lane,
                                      Visit&& visit) const {
  double T[3][3], c[3], q0[3];
  for (int i = 0; i < 3; ++i) {
    c[i] = batch.centre[i][lane];
    q0[i] = batch.rest_centre[i][lane];
    for (int j = 0; j < 3; ++j) T[i][j] = batch.T(i, j)[lane];
  }
  const auto cluster = usize(batch.cluster[usize(lane)]);
  const auto begin = usize(clusters_.start[cluster]);
  const auto end = usize(clusters_.start[cluster + 1]);
  for (std::size_t k = begin; k < end; ++k) {
    const Point<Real>& p = sweep.x[slot_[k]];
    const std::array<double, 3>& rest = clusters_.rest[k];
    const double q[3] = {rest[0] - q0[0], rest[1] - q0[1], rest[2] - q0[2]};
    const double x[3] = {p.x, p.y, p.z};
    Vector3<double> d;
    for (int i = 0; i < 3; ++i) {
      d[i] = x[i] - c[i] - (T[i][0] * q[0] + T[i][1] * q[1] + T[i][2] * q[2]);
    }
    const double w = p.w;
    visit(slot_[k], w > 0 ? 1 / w : batch.pinned_mass[usize(lane)], d, w > 0);
  }
}

template <class Real>
std::array<double, 3> ShapeMatching<Real>::measure(const Sweep<Real>& sweep, const Batch& batch,
                                                   int lane) const {
  double all = 0, free = 0, rate = 0;
  for_members(sweep, batch, lane,
              [&](std::int32_t slot, double m, const Vector3<double>& d, bool is_free) {
                const double square = m * dot(d, d);
                all += square;
                if (!is_free) return;
                free += square;
                const Point<Real>&x = sweep.x[slot], &old = sweep.x_old[slot];
                rate += m * (d[0] * (double(x.x) - old.x) + d[1] * (double(x.y) - old.y) +
                             d[2] * (double(x.z) - old.z));
              });
  return {all, free, rate};
}

// Macklin, Mueller, Chentanez, "XPBD", MIG 2016, eq. 18 and, with damping, 26.
template <class Real>
std::int64_t ShapeMatching<Real>::project_cluster(const Sweep<Real>& sweep, const Batch& batch,
                                                  int lane) {
  if (batch.pinned_mass[usize(lane)] == 0) return 1;
  const auto cluster = usize(batch.cluster[usize(lane)]);
  const auto [all, free, rate] = measure(sweep, batch, lane);
  if (!(free > 0)) return all > 0 ? 1 : 0;
  const double C = std::sqrt(all), weight = free / all;
  const double alpha = clusters_.compliance[cluster] / (sweep.h * sweep.h);
  const double gamma = clusters_.compliance[cluster] * clusters_.damping[cluster] / sweep.h;
  double& lambda = lambda_[cluster];
  const double change =
      share_[cluster] * -(C + alpha * lambda + gamma * (rate / C)) / ((1 + gamma) * weight + alpha);
  lambda += change;
  const double share = change / C;
  for_members(sweep, batch, lane,
              [&](std::int32_t slot, double, const Vector3<double>& d, bool is_free) {
                if (!is_free) return;
                Point<Real>& x = sweep.x[slot];
                x.x = static_cast<Real>(x.x + share * d[0]);
                x.y = static_cast<Real>(x.y + share * d[1]);
                x.z = static_cast<Real>(x.z + share * d[2]);
              });
  return 0;
}

template <class Real>
std::int64_t ShapeMatching<Real>::project(int phase, std::int64_t chunk, const Sweep<Real>& sweep) {
  const auto f = usize(phase);
  std::int64_t at = phase_start_[f] + chunk * kBatchesPerChunk * kLanes;
  const std::int64_t end = std::min(at + kBatchesPerChunk * kLanes, phase_start_[f + 1]);
  std::int64_t skipped = 0;
  while (at < end) {
    Batch batch;
    for (; batch.count < kLanes && at < end; ++at) {
      const std::int32_t cluster = order_[usize(at)];
      batch.cluster[usize(batch.count++)] = cluster;
      if (sweep.iteration == 0) lambda_[usize(cluster)] = 0;
    }
    match(sweep, batch);
    for (int lane = 0; lane < batch.count; ++lane) skipped += project_cluster(sweep, batch, lane);
  }
  return skipped;
}

template <class Real>
void ShapeMatching<Real>::values(const Sweep<Real>& sweep, std::span<double> c) const {
  for (std::size_t cluster = 0; cluster < lambda_.size(); ++cluster) {
    Batch batch;
    batch.count = 1;
    batch.cluster[0] = static_cast<std::int32_t>(cluster);
    match(sweep, batch);
    c[cluster] = batch.pinned_mass[0] == 0 ? 0 : std::sqrt(measure(sweep, batch, 0)[0]);
  }
}

template <class Real>
void ShapeMatching<Real>::multipliers(std::span<double> lambda) const {
  std::copy(lambda_.begin(), lambda_.end(), lambda.begin());
}

template <class Real>
double ShapeMatching<Real>::energy(const Sweep<Real>& sweep) const {
  std::vector<double> c(lambda_.size());
  values(sweep, c);
  double sum = 0;
  for (std::size_t k = 0; k < c.size(); ++k) {
    if (clusters_.compliance[k] > 0) sum += c[k] * c[k] / (2 * clusters_.compliance[k]);
  }
  return sum;
}

template class ShapeMatching<float>;
template class ShapeMatching<double>;

}  // namespace substep::pbd
