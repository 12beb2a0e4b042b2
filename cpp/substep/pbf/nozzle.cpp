#include "substep/pbf/nozzle.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/usize.h"

namespace substep::pbf {

Nozzle::Nozzle(const geometry::Emitter& emitter, const KernelFunction& value,
               const KernelFunction& slope, double h)
    : emitter_(emitter), value_(value), slope_(slope), h_(h) {
  // In two dimensions the offsets lie along the second.
  const Vec3 n = emitter.direction;
  across_[0] =
      (std::abs(n.z()) < 0.9 ? n.cross(Vec3::UnitZ()) : n.cross(Vec3::UnitX())).normalized();
  across_[1] = n.cross(across_[0]);
  for (std::size_t d = 0; d < 2; ++d) {
    low_[d] = std::numeric_limits<double>::infinity();
    high_[d] = -low_[d];
    for (const Vec3& offset : emitter.offsets) {
      low_[d] = std::min(low_[d], across_[d].dot(offset));
      high_[d] = std::max(high_[d], across_[d].dot(offset));
    }
    cells_[d] = static_cast<std::int64_t>(std::floor((high_[d] - low_[d]) / h)) + 1;
  }
  const auto cell = [&](const Vec3& offset) {
    const auto at = [&](std::size_t d) {
      return std::clamp<std::int64_t>(
          static_cast<std::int64_t>((across_[d].dot(offset) - low_[d]) / h), 0, cells_[d] - 1);
    };
    return usize(at(0) * cells_[1] + at(1));
  };
  first_.assign(usize(cells_[0] * cells_[1]) + 1, 0);
  for (const Vec3& offset : emitter.offsets) ++first_[cell(offset) + 1];
  for (std::size_t c = 1; c < first_.size(); ++c) first_[c] += first_[c - 1];
  order_.resize(emitter.offsets.size());
  std::vector<std::int64_t> next(first_.begin(), first_.end() - 1);
  for (std::size_t k = 0; k < order_.size(); ++k)
    order_[usize(next[cell(emitter.offsets[k])]++)] = k;
}

void Nozzle::place(std::int64_t layers, double time) {
  travelled_.clear();
  left_out_.clear();
  if (!(time >= emitter_.start)) return;
  const geometry::Emitter& e = emitter_;
  // Layers up to two supports behind, of those that leave before it stops.
  const double gone = (time - e.start) * e.speed;
  const double last = (e.stop - e.start) * e.speed + 1e-9 * e.thickness;
  const double number =
      std::floor(std::min(gone + 2 * h_, last) / e.thickness) + 1 - static_cast<double>(layers);
  // So many at once come out in no step (ParticleFlow::check).
  if (!(number * static_cast<double>(order_.size()) <=
        static_cast<double>(2 * geometry::ParticleFlow::kMostAtOnce))) {
    return;
  }
  for (std::int64_t k = layers; k < layers + static_cast<std::int64_t>(number); ++k)
    travelled_.push_back(gone - e.thickness * static_cast<double>(k));
  left_out_.assign(travelled_.size() * e.offsets.size(), 0);
}

bool Nozzle::near(const Vec3& x, double reach) const {
  if (travelled_.empty()) return false;
  const Vec3 from = x - emitter_.position;
  const double along = emitter_.direction.dot(from);
  if (along > travelled_.front() + reach || along < travelled_.back() - reach) return false;
  for (std::size_t d = 0; d < 2; ++d) {
    const double a = across_[d].dot(from);
    if (a < low_[d] - reach || a > high_[d] + reach) return false;
  }
  return true;
}

// visit(number, x - point) for points that may be nearer than h.
template <class Visit>
void Nozzle::for_points(const Vec3& x, const Visit& visit) const {
  const Vec3 from = x - emitter_.position;
  const double along = emitter_.direction.dot(from);
  std::int64_t cell[2];
  for (std::size_t d = 0; d < 2; ++d) {
    const double q = std::floor((across_[d].dot(from) - low_[d]) / h_);
    cell[d] = static_cast<std::int64_t>(std::clamp(q, -2.0, static_cast<double>(cells_[d]) + 1));
  }
  for (std::size_t layer = 0; layer < travelled_.size(); ++layer) {
    if (std::abs(along - travelled_[layer]) >= h_) continue;
    const Vec3 to = from - travelled_[layer] * emitter_.direction;
    for (std::int64_t a = std::max<std::int64_t>(cell[0] - 1, 0);
         a <= std::min(cell[0] + 1, cells_[0] - 1); ++a) {
      const std::int64_t begin = std::max<std::int64_t>(cell[1] - 1, 0),
                         end = std::min(cell[1] + 1, cells_[1] - 1) + 1;
      if (begin >= end) continue;
      for (auto k = usize(first_[usize(a * cells_[1] + begin)]);
           k < usize(first_[usize(a * cells_[1] + end)]); ++k) {
        visit(layer * order_.size() + order_[k], to - emitter_.offsets[order_[k]]);
      }
    }
  }
}

void Nozzle::leave_out(const std::function<bool(const Vec3&)>& covered) {
  const std::size_t points = emitter_.offsets.size();
  for (std::size_t number = 0; number < left_out_.size(); ++number) {
    const Vec3 x = emitter_.position + travelled_[number / points] * emitter_.direction +
                   emitter_.offsets[number % points];
    if (covered(x)) left_out_[number] = 1;
  }
}

WallDensity Nozzle::density(const Vec3& x) const {
  WallDensity sum;
  for_points(x, [&](std::size_t number, const Vec3& away) {
    const double r = away.norm();
    if (left_out_[number] != 0 || r >= h_) return;
    sum.value += value_(r);
    if (r > 0) sum.gradient += slope_(r) / r * away;
  });
  return sum;
}

}  // namespace substep::pbf
