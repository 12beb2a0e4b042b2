// A group of constraints that are formulas: made of any struct of constraint.h, swept in the order
// of colouring.h by the kernels of project.h.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/pbd/groups/colouring.h"
#include "substep/pbd/groups/project.h"

namespace substep::pbd {

// How hard constraints are: each list has one number for all or one for each.
struct Softness {
  bool physical = true;            // XPBD; else plain PBD
  std::vector<double> compliance;  // alpha, at least 0; the inverse of a stiffness
  std::vector<double> damping;     // beta, at least 0
  std::vector<double> stiffness;   // k of plain PBD, 0 to 1
};

template <class Constraint, class Real>
class ConstraintGroup final : public Group<Real> {
  using Kernel = Projection<Constraint, Real>;
  using Block = typename Kernel::Block;
  using Lanes = typename Kernel::Lanes;
  static constexpr std::size_t kPoints = Kernel::kPoints, kParameters = Kernel::kParameters;
  static constexpr std::size_t kLanes = Kernel::kLanes;
  static constexpr std::size_t kCorrectionBlocks = 128;  // per task

 public:
  // particles: kPoints for each constraint; parameters: kParameters for each.
  ConstraintGroup(std::vector<std::int32_t> particles, std::vector<double> parameters,
                  Softness softness)
      : particles_(std::move(particles)),
        parameters_(std::move(parameters)),
        softness_(std::move(softness)),
        size_(static_cast<std::int64_t>(particles_.size() / kPoints)) {}

  std::unique_ptr<Group<Real>> clone() const override {
    return std::make_unique<ConstraintGroup>(*this);
  }
  std::int64_t size() const override { return size_; }

  void attach(const Partition& partition) override {
    for (std::int32_t& p : particles_) p = partition.slot[static_cast<std::size_t>(p)];
    schedule_ = make_schedule(particles_, kPoints, kLanes, partition);
    const auto empty = static_cast<std::int64_t>(partition.id.size());
    blocks_.resize(schedule_.constraint.size() / kLanes);
    for (std::size_t k = 0; k < schedule_.constraint.size(); ++k) {
      Block& block = blocks_[k / kLanes];
      const std::size_t lane = k % kLanes;
      const auto c = static_cast<std::size_t>(std::max(schedule_.constraint[k], 0));
      for (std::size_t i = 0; i < kPoints; ++i) {
        const auto slot = schedule_.constraint[k] < 0 ? empty : particles_[c * kPoints + i];
        block.place[i][lane] = static_cast<std::uint32_t>(slot * Kernel::kUnits);
      }
      for (std::size_t i = 0; i < kParameters; ++i) {
        block.parameter[i][lane] = static_cast<Real>(parameters_[c * kParameters + i]);
      }
    }
    std::vector<std::int32_t>().swap(particles_);
    std::vector<double>().swap(parameters_);
    compliance_ = in_blocks(softness_.compliance);
    damping_ = in_blocks(softness_.damping);
    stiffness_ = in_blocks({1.0});
    multiplier_.assign(blocks_.size(), Lanes{});
    if (softness_.physical && any_positive(softness_.compliance)) {
      softening_ = any_positive(softness_.damping) ? Softening::damped : Softening::soft;
    }
  }

  void begin_step(double /*h*/, int substeps, int iterations) override {
    if (softness_.physical) return;
    const double n = static_cast<double>(substeps) * iterations;
    std::vector<double> factor = softness_.stiffness;
    for (double& k : factor) k = -std::expm1(std::log1p(-k) / n);
    stiffness_ = in_blocks(factor);
  }

  std::int64_t project_patch(std::int64_t patch, const Sweep<Real>& s) override {
    const auto p = static_cast<std::size_t>(patch);
    return project_blocks(schedule_.patch_start[p], schedule_.patch_start[p + 1], s);
  }
  int phases() const override { return schedule_.phases(); }
  std::int64_t chunks(int phase) const override {
    const auto f = static_cast<std::size_t>(phase);
    return schedule_.phase_start[f + 1] - schedule_.phase_start[f];
  }
  std::int64_t project(int phase, std::int64_t chunk, const Sweep<Real>& s) override {
    const auto c =
        static_cast<std::size_t>(schedule_.phase_start[static_cast<std::size_t>(phase)] + chunk);
    return project_blocks(schedule_.chunk_start[c], schedule_.chunk_start[c + 1], s);
  }

  std::vector<std::int32_t> holders() const override {
    std::vector<std::int32_t> rows;
    rows.reserve(blocks_.size() * kPoints * kLanes);
    for (std::size_t b = 0; b < blocks_.size(); ++b) {
      for (const auto& places : blocks_[b].place) {
        for (std::size_t lane = 0; lane < kLanes; ++lane) {
          const auto slot = static_cast<std::int32_t>(places[lane] / Kernel::kUnits);
          rows.push_back(schedule_.constraint[b * kLanes + lane] < 0 ? -1 : slot);
        }
      }
    }
    return rows;
  }
  std::int64_t correction_chunks() const override {
    return static_cast<std::int64_t>((blocks_.size() + kCorrectionBlocks - 1) / kCorrectionBlocks);
  }
  std::int64_t correct(std::int64_t chunk, const Sweep<Real>& s, Point<Real>* rows) override {
    const std::size_t begin = static_cast<std::size_t>(chunk) * kCorrectionBlocks;
    const std::size_t end = std::min(begin + kCorrectionBlocks, blocks_.size());
    return with_softening([&]<Softening kSoftening>() {
      return Kernel::template correct<kSoftening>(blocks_.data(), begin, end, s, softness(s), rows);
    });
  }

  void values(const Sweep<Real>& s, std::span<double> c) const override {
    for (std::size_t b = 0; b < blocks_.size(); ++b) {
      typename Kernel::Evaluation e;
      Kernel::evaluate(blocks_[b], s.x, e);
      for_lanes(b, [&](std::size_t constraint, std::size_t lane) {
        c[constraint] = static_cast<double>(e.c[lane]);
      });
    }
  }
  void multipliers(std::span<double> lambda) const override {
    for (std::size_t b = 0; b < blocks_.size(); ++b) {
      for_lanes(b, [&](std::size_t constraint, std::size_t lane) {
        lambda[constraint] = static_cast<double>(multiplier_[b].values[lane]);
      });
    }
  }
  double energy(const Sweep<Real>& s) const override {
    if (softening_ == Softening::rigid) return 0;
    std::vector<double> c(static_cast<std::size_t>(size_));
    values(s, c);
    double sum = 0;
    for (std::size_t j = 0; j < c.size(); ++j) {
      const double alpha = softness_.compliance[softness_.compliance.size() > 1 ? j : 0];
      if (alpha > 0 && (!Constraint::kInequality || c[j] < 0)) sum += c[j] * c[j] / (2 * alpha);
    }
    return sum;
  }

 private:
  std::vector<Lanes> in_blocks(const std::vector<double>& values) const {
    std::vector<Lanes> lanes(values.size() > 1 ? blocks_.size() : values.size());
    for (std::size_t b = 0; b < lanes.size(); ++b) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const std::size_t at = values.size() > 1 ? b * kLanes + lane : 0;
        const std::int32_t c = values.size() > 1 ? schedule_.constraint[at] : 0;
        lanes[b].values[lane] = static_cast<Real>(values[static_cast<std::size_t>(std::max(c, 0))]);
      }
    }
    return lanes;
  }
  static typename Kernel::Each each(const std::vector<Lanes>& lanes) {
    return {lanes.data(), lanes.size() > 1 ? std::size_t{1} : 0};
  }
  static bool any_positive(const std::vector<double>& list) {
    return std::any_of(list.begin(), list.end(), [](double a) { return a > 0; });
  }

  // lambda is needed where a later iteration or the report after the step reads it.
  typename Kernel::Softness softness(const Sweep<Real>& s) {
    const bool needed = (softening_ != Softening::rigid && s.iterations > 1) || s.last_substep();
    return {each(compliance_), each(damping_), each(stiffness_),
            needed ? multiplier_.data() : nullptr, needed && s.iteration > 0};
  }

  template <class Function>
  std::int64_t with_softening(Function&& function) {
    if (softening_ == Softening::rigid) return function.template operator()<Softening::rigid>();
    if (softening_ == Softening::soft) return function.template operator()<Softening::soft>();
    return function.template operator()<Softening::damped>();
  }

  std::int64_t project_blocks(std::int64_t begin, std::int64_t end, const Sweep<Real>& s) {
    return with_softening([&]<Softening kSoftening>() {
      return Kernel::template project<kSoftening>(blocks_.data(), static_cast<std::size_t>(begin),
                                                  static_cast<std::size_t>(end), s, softness(s));
    });
  }

  template <class Function>
  void for_lanes(std::size_t b, Function&& function) const {
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::int32_t c = schedule_.constraint[b * kLanes + lane];
      if (c >= 0) function(static_cast<std::size_t>(c), lane);
    }
  }

  std::vector<std::int32_t> particles_;  // until attach()
  std::vector<double> parameters_;
  Softness softness_;
  std::int64_t size_;
  Softening softening_ = Softening::rigid;
  Schedule schedule_;
  std::vector<Block> blocks_;
  std::vector<Lanes> compliance_, damping_, stiffness_, multiplier_;
};

}  // namespace substep::pbd
