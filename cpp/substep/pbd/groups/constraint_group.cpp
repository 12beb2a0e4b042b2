#include "substep/pbd/groups/constraint_group.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

bool any_positive(const std::vector<double>& list) {
  return std::any_of(list.begin(), list.end(), [](double a) { return a > 0; });
}

template <class Real>
EachLane<Real> each(const std::vector<RealLanes<Real>>& lanes) {
  return {lanes.data(), lanes.size() > 1 ? std::size_t{1} : 0};
}

}  // namespace

template <class Real>
ConstraintGroup<Real>::ConstraintGroup(const Kernels<Real>& kernels,
                                       std::vector<std::int32_t> particles,
                                       std::vector<double> parameters, Softness softness)
    : kernels_(kernels),
      particles_(std::move(particles)),
      parameters_(std::move(parameters)),
      softness_(std::move(softness)),
      size_(static_cast<std::int64_t>(particles_.size() / kernels.points)),
      lines_(Kernels<Real>::lines(kernels.points, kernels.parameters)) {}

template <class Real>
std::unique_ptr<Group<Real>> ConstraintGroup<Real>::clone() const {
  return std::make_unique<ConstraintGroup>(*this);
}

template <class Real>
void ConstraintGroup<Real>::attach(const Partition& partition) {
  const std::size_t points = kernels_.points, parameters = kernels_.parameters;
  for (std::int32_t& p : particles_) p = partition.slot[usize(p)];
  schedule_ = make_schedule(particles_, static_cast<int>(points), kLanes, partition);
  const auto empty = static_cast<std::int64_t>(partition.id.size());
  blocks_.resize(block_count() * lines_);
  for (std::size_t k = 0; k < schedule_.constraint.size(); ++k) {
    auto* const block = reinterpret_cast<std::byte*>(&blocks_[k / kLanes * lines_]);
    const std::size_t lane = k % kLanes;
    const auto c = usize(std::max(schedule_.constraint[k], 0));
    for (std::size_t i = 0; i < points; ++i) {
      const auto slot = schedule_.constraint[k] < 0 ? empty : particles_[c * points + i];
      const auto place = static_cast<std::uint32_t>(slot * Kernels<Real>::kUnits);
      std::memcpy(block + (i * kLanes + lane) * sizeof place, &place, sizeof place);
    }
    for (std::size_t i = 0; i < parameters; ++i) {
      const auto parameter = static_cast<Real>(parameters_[c * parameters + i]);
      std::memcpy(
          block + Kernels<Real>::first_parameter(points) + (i * kLanes + lane) * sizeof parameter,
          &parameter, sizeof parameter);
    }
  }
  std::vector<std::int32_t>().swap(particles_);
  std::vector<double>().swap(parameters_);
  compliance_ = in_blocks(softness_.compliance);
  damping_ = in_blocks(softness_.damping);
  stiffness_ = in_blocks({1.0});
  multiplier_.assign(block_count(), Lanes{});
  if (softness_.physical && any_positive(softness_.compliance)) {
    softening_ = any_positive(softness_.damping) ? Softening::damped : Softening::soft;
  }
}

template <class Real>
void ConstraintGroup<Real>::begin_step(double /*h*/, int substeps, int iterations) {
  if (softness_.physical) return;
  const double n = static_cast<double>(substeps) * iterations;
  std::vector<double> factor = softness_.stiffness;
  for (double& k : factor) k = -std::expm1(std::log1p(-k) / n);
  stiffness_ = in_blocks(factor);
}

template <class Real>
std::int64_t ConstraintGroup<Real>::project_patch(std::int64_t patch, const Sweep<Real>& s) {
  const auto p = usize(patch);
  return project_blocks(schedule_.patch_start[p], schedule_.patch_start[p + 1], s);
}

template <class Real>
std::int64_t ConstraintGroup<Real>::chunks(int phase) const {
  const auto f = usize(phase);
  return schedule_.phase_start[f + 1] - schedule_.phase_start[f];
}

template <class Real>
std::int64_t ConstraintGroup<Real>::project(int phase, std::int64_t chunk, const Sweep<Real>& s) {
  const auto c = usize(schedule_.phase_start[usize(phase)] + chunk);
  return project_blocks(schedule_.chunk_start[c], schedule_.chunk_start[c + 1], s);
}

template <class Real>
std::vector<std::int32_t> ConstraintGroup<Real>::holders() const {
  std::vector<std::int32_t> rows;
  rows.reserve(schedule_.constraint.size() * kernels_.points);
  for (std::size_t b = 0; b < block_count(); ++b) {
    const auto* place = reinterpret_cast<const std::byte*>(&blocks_[b * lines_]);
    for (std::size_t i = 0; i < kernels_.points; ++i) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        std::uint32_t at;
        std::memcpy(&at, place, sizeof at);
        place += sizeof at;
        const auto slot = static_cast<std::int32_t>(at / Kernels<Real>::kUnits);
        rows.push_back(schedule_.constraint[b * kLanes + lane] < 0 ? -1 : slot);
      }
    }
  }
  return rows;
}

template <class Real>
std::int64_t ConstraintGroup<Real>::correction_chunks() const {
  return static_cast<std::int64_t>((block_count() + kCorrectionBlocks - 1) / kCorrectionBlocks);
}

template <class Real>
std::int64_t ConstraintGroup<Real>::correct(std::int64_t chunk, const Sweep<Real>& s,
                                            Point<Real>* rows) {
  const std::size_t begin = usize(chunk) * kCorrectionBlocks;
  const std::size_t end = std::min(begin + kCorrectionBlocks, block_count());
  return kernels_.correct(blocks_.data(), begin, end, s, softness(s), rows);
}

template <class Real>
void ConstraintGroup<Real>::values(const Sweep<Real>& s, std::span<double> c) const {
  for (std::size_t b = 0; b < block_count(); ++b) {
    Lanes of_block;
    kernels_.values(&blocks_[b * lines_], s.x, of_block.values);
    for_lanes(b, [&](std::size_t constraint, std::size_t lane) {
      c[constraint] = static_cast<double>(of_block.values[lane]);
    });
  }
}

template <class Real>
void ConstraintGroup<Real>::multipliers(std::span<double> lambda) const {
  for (std::size_t b = 0; b < block_count(); ++b) {
    for_lanes(b, [&](std::size_t constraint, std::size_t lane) {
      lambda[constraint] = static_cast<double>(multiplier_[b].values[lane]);
    });
  }
}

template <class Real>
double ConstraintGroup<Real>::energy(const Sweep<Real>& s) const {
  if (softening_ == Softening::rigid) return 0;
  std::vector<double> c(usize(size_));
  values(s, c);
  double sum = 0;
  for (std::size_t j = 0; j < c.size(); ++j) {
    const double alpha = softness_.compliance[softness_.compliance.size() > 1 ? j : 0];
    if (alpha > 0 && (!kernels_.inequality || c[j] < 0)) sum += c[j] * c[j] / (2 * alpha);
  }
  return sum;
}

template <class Real>
std::vector<RealLanes<Real>> ConstraintGroup<Real>::in_blocks(
    const std::vector<double>& values) const {
  std::vector<Lanes> lanes(values.size() > 1 ? block_count() : values.size());
  for (std::size_t b = 0; b < lanes.size(); ++b) {
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::size_t at = values.size() > 1 ? b * kLanes + lane : 0;
      const std::int32_t c = values.size() > 1 ? schedule_.constraint[at] : 0;
      lanes[b].values[lane] = static_cast<Real>(values[usize(std::max(c, 0))]);
    }
  }
  return lanes;
}

// lambda is needed where a later iteration or the report after the step reads it.
template <class Real>
LaneSoftness<Real> ConstraintGroup<Real>::softness(const Sweep<Real>& s) {
  const bool needed = (softening_ != Softening::rigid && s.iterations > 1) || s.last_substep();
  return {softening_,
          each(compliance_),
          each(damping_),
          each(stiffness_),
          needed ? multiplier_.data() : nullptr,
          needed && s.iteration > 0};
}

template <class Real>
std::int64_t ConstraintGroup<Real>::project_blocks(std::int64_t begin, std::int64_t end,
                                                   const Sweep<Real>& s) {
  return kernels_.project(blocks_.data(), usize(begin), usize(end), s, softness(s));
}

template <class Real>
template <class Function>
void ConstraintGroup<Real>::for_lanes(std::size_t b, Function&& function) const {
  for (std::size_t lane = 0; lane < kLanes; ++lane) {
    const std::int32_t c = schedule_.constraint[b * kLanes + lane];
    if (c >= 0) function(usize(c), lane);
  }
}

template class ConstraintGroup<float>;
template class ConstraintGroup<double>;

}  // namespace substep::pbd
