#include "substep/pbd/contact/particle_collision.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

constexpr double kMargin = 0.25;  // in largest radii: pairs that the projections bring together
constexpr double kRestOfParticles =
    0.99;  // of the distance at rest, so that rounding exerts nothing
constexpr std::int64_t kParticlesPerTask = 512;

}  // namespace

template <class Real>
ParticleCollision<Real>::ParticleCollision(std::vector<double> radii, std::vector<double> rest,
                                           double friction)
    : radii_(std::move(radii)), rest_(std::move(rest)), friction_(static_cast<Real>(friction)) {}

template <class Real>
std::unique_ptr<Group<Real>> ParticleCollision<Real>::clone() const {
  auto copy = std::make_unique<ParticleCollision>(radii_, rest_, static_cast<double>(friction_));
  copy->balls_ = balls_;
  copy->radius_ = radius_;
  copy->start_ = start_;
  copy->largest_ = largest_;
  return copy;
}

template <class Real>
void ParticleCollision<Real>::attach(const Partition& partition) {
  balls_.clear();
  radius_.clear();
  start_.clear();
  for (std::size_t slot = 0; slot < partition.id.size(); ++slot) {
    const auto id = usize(partition.id[slot]);
    if (radii_[id] == 0) continue;
    balls_.push_back(static_cast<std::int32_t>(slot));
    radius_.push_back(static_cast<Real>(radii_[id]));
    start_.push_back({rest_[3 * id], rest_[3 * id + 1], rest_[3 * id + 2]});
  }
  largest_ = radius_.empty() ? 0 : *std::max_element(radius_.begin(), radius_.end());
}

template <class Real>
void ParticleCollision<Real>::prepare(const Sweep<Real>& s, int threads) {
  contacts_.clear();
  points_.resize(balls_.size());
  sorted_.resize(balls_.size());
  for (std::size_t k = 0; k < balls_.size(); ++k) {
    points_[k] = s.x[balls_[k]];
    const Point<Real>& p = points_[k];
    if (!std::isfinite(p.x + p.y + p.z)) return;  // the solver will say so
  }
  if (points_.empty()) return;
  const Real within = static_cast<Real>(2 + kMargin) * largest_;
  try {
    near_.sort(points_, within, threads);
  } catch (const InputError& error) {
    throw SolverError("collisions of particles that have gone too far away: " +
                      std::string(error.what()));
  }
  const auto order = near_.order();
  for (std::size_t k = 0; k < order.size(); ++k) {
    sorted_[k] = points_[usize(order[k])];
  }
  near_.find(sorted_, within, geometry::Pairs::kHalf, threads);
  const std::int64_t n = near_.size();
  std::vector<std::vector<Contact>> parts(usize((n + kParticlesPerTask - 1) / kParticlesPerTask));
  const Real margin = static_cast<Real>(kMargin) * largest_;
  parallel_for(
      n, kParticlesPerTask,
      [&](std::int64_t begin, std::int64_t end) {
        auto& part = parts[usize(begin / kParticlesPerTask)];
        for (std::int64_t k = begin; k < end; ++k) {
          const auto i = usize(order[usize(k)]);
          const geometry::NeighbourList list = near_[k];
          for (std::int32_t m = 0; m < list.count; ++m) {
            const auto j = usize(order[usize(list.indices[m])]);
            const Point<Real>&p = points_[i], &q = points_[j];
            const Real sum = radius_[i] + radius_[j];
            const Real dx = p.x - q.x, dy = p.y - q.y, dz = p.z - q.z;
            if (dx * dx + dy * dy + dz * dz >= (sum + margin) * (sum + margin)) continue;
            const double at_rest =
                std::hypot(start_[i][0] - start_[j][0], start_[i][1] - start_[j][1],
                           start_[i][2] - start_[j][2]);
            const auto kept = static_cast<Real>(kRestOfParticles * at_rest);
            part.push_back({balls_[i], balls_[j], std::min(sum, kept)});
          }
        }
      },
      threads);
  for (const auto& part : parts) contacts_.insert(contacts_.end(), part.begin(), part.end());
}

template <class Real>
std::int64_t ParticleCollision<Real>::project(int, std::int64_t, const Sweep<Real>& s) {
  std::int64_t skipped = 0;
  for (const Contact& contact : contacts_) {
    Point<Real>&a = s.x[contact.a], &b = s.x[contact.b];
    const std::array<Real, 3> r{a.x - b.x, a.y - b.y, a.z - b.z};
    const Real squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2];
    const Real weight = a.w + b.w;
    if (squared >= contact.distance * contact.distance || weight == 0) continue;
    const Real d = std::sqrt(squared);
    if (d == 0) {
      ++skipped;
      continue;
    }
    const Real c = d - contact.distance;
    std::array<Real, 3> push{-c / d * r[0], -c / d * r[1], -c / d * r[2]};
    if (friction_ > 0) {
      const Point<Real>&a0 = s.x_old[contact.a], &b0 = s.x_old[contact.b];
      std::array<Real, 3> way{(a.x - a0.x) - (b.x - b0.x), (a.y - a0.y) - (b.y - b0.y),
                              (a.z - a0.z) - (b.z - b0.z)};
      const Real along = (way[0] * r[0] + way[1] * r[1] + way[2] * r[2]) / squared;
      for (std::size_t k = 0; k < 3; ++k) way[k] -= along * r[k];
      const Real length = std::sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
      const Real part = friction_ * -c < length ? friction_ * -c / length : Real{1};
      for (std::size_t k = 0; k < 3; ++k) push[k] -= part * way[k];
    }
    const Real share_a = a.w / weight, share_b = b.w / weight;
    a.x += share_a * push[0], a.y += share_a * push[1], a.z += share_a * push[2];
    b.x -= share_b * push[0], b.y -= share_b * push[1], b.z -= share_b * push[2];
  }
  return skipped;
}

template class ParticleCollision<float>;
template class ParticleCollision<double>;

}  // namespace substep::pbd
