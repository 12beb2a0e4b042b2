// A group of constraints that are formulas (constraint.h), projected as many at once as a vector
// has lanes. For each constraint j (XPBD: Macklin, Mueller, Chentanez 2016, eq. 18 and 26)
//
//   dlambda = (-C - a lambda - g grad C . (x - x_old)) / ((1 + g) sum_i w_i |grad_i C|^2 + a)
//   x_i += w_i grad_i C dlambda,   lambda += dlambda,
//   a = alpha / h^2, g = alpha beta / h,
//
// with compliance alpha, damping beta, and x_old the positions at the start of the substep. Plain
// PBD is a = g = 0 and dlambda scaled by 1 - (1 - k)^(1/n), so that a part 1 - k of the error is
// left after the n projections of a step (Mueller et al. 2007, section 3.3).
//
// Jacobi splits the mass of a particle that n_i constraints hold in n_i parts, which each see n_i
// w_i and are joined at their mean (Tonge, Benevolenski, Voroshilov 2012): all corrections of one
// iteration are then together no more than a step to the solution, momentum is kept, and lambda
// stays the multiplier of what was moved. `relaxation` scales dlambda.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/matrix3.h"
#include "substep/pbd/colouring.h"
#include "substep/pbd/constraint.h"
#include "substep/pbd/group.h"
#include "substep/pbd/scatter.h"

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
 public:
  static constexpr int kPoints = Constraint::kPoints, kParameters = Constraint::kParameters;
  using V = Vector<Real>;
  static constexpr int kLanes = sizeof(V) / sizeof(Real);

  // particles: kPoints for each constraint; parameters: kParameters for each.
  ConstraintGroup(std::vector<std::int32_t> particles, std::vector<double> parameters,
                  Softness softness)
      : particles_(std::move(particles)),
        parameters_(std::move(parameters)),
        softness_(std::move(softness)),
        size_(static_cast<std::int64_t>(particles_.size()) / kPoints) {}

  std::unique_ptr<Group<Real>> clone() const override {
    return std::make_unique<ConstraintGroup>(*this);
  }
  std::int64_t size() const override { return size_; }

  void attach(const Partition& partition) override {
    for (std::int32_t& p : particles_) p = partition.slot[static_cast<std::size_t>(p)];
    schedule_ = make_schedule(particles_, kPoints, kLanes, partition);
    const auto empty = static_cast<std::int32_t>(partition.id.size());
    blocks_.resize(schedule_.constraint.size() / kLanes);
    for (std::size_t k = 0; k < schedule_.constraint.size(); ++k) {
      Block& block = blocks_[k / kLanes];
      const std::size_t lane = k % kLanes;
      const std::int32_t c = schedule_.constraint[k];
      for (std::size_t i = 0; i < kPoints; ++i) {
        block.index[i][lane] =
            c < 0 ? empty : particles_[static_cast<std::size_t>(c) * kPoints + i];
      }
      for (std::size_t i = 0; i < kParameters; ++i) {
        block.parameter[i][lane] = static_cast<Real>(
            parameters_[static_cast<std::size_t>(std::max(c, 0)) * kParameters + i]);
      }
    }
    compliance_ = in_blocks(softness_.compliance);
    damping_ = in_blocks(softness_.damping);
    stiffness_ = in_blocks(softness_.stiffness);
    soft_ = softness_.physical && any_positive(softness_.compliance);
    damped_ = soft_ && any_positive(softness_.damping);
    multiplier_.assign(blocks_.size(), Lanes{});
    particles_ = {};
    parameters_ = {};
  }

  void begin_step(double h, int substeps, int iterations) override {
    h_ = h;
    if (softness_.physical) return;
    const double n = static_cast<double>(substeps) * iterations;
    std::vector<double> scale = softness_.stiffness;
    for (double& k : scale) k = -std::expm1(std::log1p(-k) / n);
    scaled_ = std::any_of(scale.begin(), scale.end(), [](double k) { return k < 1; });
    stiffness_ = in_blocks(scale);
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

  std::span<const std::int32_t> holders() const override {
    if (holders_.empty()) {
      holders_.reserve(blocks_.size() * kPoints * kLanes);
      for (std::size_t k = 0; k < blocks_.size(); ++k) {
        for (const auto& lanes : blocks_[k].index) {
          for (std::size_t lane = 0; lane < kLanes; ++lane) {
            const bool filled = schedule_.constraint[k * kLanes + lane] >= 0;
            holders_.push_back(filled ? lanes[lane] : -1);
          }
        }
      }
    }
    return holders_;
  }
  std::int64_t correction_chunks() const override {
    return (static_cast<std::int64_t>(blocks_.size()) + kCorrectionBlocks - 1) / kCorrectionBlocks;
  }
  std::int64_t correct(std::int64_t chunk, const Sweep<Real>& s, Point<Real>* rows) override {
    const auto begin = static_cast<std::size_t>(chunk * kCorrectionBlocks);
    const std::size_t end = std::min(begin + kCorrectionBlocks, blocks_.size());
    const Constants k(*this, s);
    std::int64_t skipped = 0;
    for (std::size_t b = begin; b < end; ++b) {
      Evaluation e;
      evaluate(blocks_[b], s.x, e);
      std::array<V, kPoints> w;
      for (std::size_t i = 0; i < kPoints; ++i) {
        for (std::size_t lane = 0; lane < kLanes; ++lane) {
          w[i][lane] = e.p[i].w[lane] * static_cast<Real>(s.splits[blocks_[b].index[i][lane]]);
        }
      }
      const V dlambda = static_cast<Real>(s.relaxation) * update(b, s, k, w, e, skipped);
      if (k.store) store_multiplier(b, k, dlambda);
      for (std::size_t i = 0; i < kPoints; ++i) {
        const V scale = dlambda * e.p[i].w;
        Point<Real>* const out = rows + (b * kPoints + i) * kLanes;
        store_rows<V>(
            {e.gradient[i].x * scale, e.gradient[i].y * scale, e.gradient[i].z * scale, V{}},
            [&](int lane) { return out + lane; });
      }
    }
    return skipped;
  }

  void values(const Sweep<Real>& s, std::span<double> c) const override {
    for (std::size_t b = 0; b < blocks_.size(); ++b) {
      Evaluation e;
      evaluate(blocks_[b], s.x, e);
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
    if (!soft_) return 0;
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
  struct alignas(kVectorBytes) Block {
    std::int32_t index[kPoints][kLanes];
    Real parameter[kParameters > 0 ? kParameters : 1][kLanes];
  };
  struct alignas(kVectorBytes) Lanes {
    Real values[kLanes];
  };
  static constexpr std::size_t kCorrectionBlocks = 128;

  // What one block evaluates to at the present positions.
  struct Evaluation {
    std::array<PointLanes<V>, kPoints> p;
    std::array<Lanes3<V>, kPoints> gradient;
    V c;
  };

  // Of one sweep, the same for all blocks.
  struct Constants {
    Constants(const ConstraintGroup& g, const Sweep<Real>& s)
        : soft(g.soft_),
          damped(g.damped_),
          scaled(g.scaled_),
          alpha_factor(static_cast<Real>(1 / (s.h * s.h))),
          gamma_factor(static_cast<Real>(s.h)),
          store((soft && s.iterations > 1) || s.last_substep()),
          load(store && s.iteration > 0) {
      if (g.compliance_.size() == 1) alpha = load_lanes(g.compliance_, 0) * alpha_factor;
      if (g.damping_.size() == 1) beta = load_lanes(g.damping_, 0);
      if (g.stiffness_.size() == 1) stiffness = load_lanes(g.stiffness_, 0);
    }
    bool soft, damped, scaled;
    Real alpha_factor, gamma_factor;
    bool store, load;  // lambda
    V alpha{}, beta{}, stiffness{};
  };

  static V load_lanes(const std::vector<Lanes>& list, std::size_t block) {
    return substep::load<V>(list[block].values);
  }

  // One number for all constraints: one entry; otherwise one for each block.
  std::vector<Lanes> in_blocks(const std::vector<double>& values) const {
    std::vector<Lanes> lanes(values.size() == 1 ? 1 : values.empty() ? 0 : blocks_.size());
    for (std::size_t b = 0; b < lanes.size(); ++b) {
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const std::int32_t c =
            schedule_.constraint.empty() ? 0 : schedule_.constraint[b * kLanes + lane];
        const std::size_t j = values.size() == 1 || c < 0 ? 0 : static_cast<std::size_t>(c);
        lanes[b].values[lane] = static_cast<Real>(values[j]);
      }
    }
    return lanes;
  }
  static bool any_positive(const std::vector<double>& list) {
    return std::any_of(list.begin(), list.end(), [](double a) { return a > 0; });
  }

  template <class Function>
  void for_lanes(std::size_t b, Function&& function) const {
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::int32_t c = schedule_.constraint[b * kLanes + lane];
      if (c >= 0) function(static_cast<std::size_t>(c), lane);
    }
  }

  SUBSTEP_INLINE static void evaluate(const Block& block, const Point<Real>* x, Evaluation& e) {
    std::array<Lanes3<V>, kPoints> at;
    for (std::size_t i = 0; i < kPoints; ++i) {
      e.p[i] = load_points<V>(x, block.index[i]);
      at[i] = {e.p[i].x, e.p[i].y, e.p[i].z};
    }
    std::array<V, kParameters> parameters;
    for (std::size_t i = 0; i < kParameters; ++i) {
      parameters[i] = substep::load<V>(block.parameter[i]);
    }
    Constraint::template evaluate<V>(at, parameters, e.c, e.gradient);
  }

  // dlambda; w are the inverse masses that the constraints see.
  SUBSTEP_INLINE V update(std::size_t b, const Sweep<Real>& s, const Constants& k,
                          const std::array<V, kPoints>& w, const Evaluation& e,
                          std::int64_t& skipped) const {
    V squares{}, weight{};
    for (std::size_t i = 0; i < kPoints; ++i) {
      const auto& g = e.gradient[i];
      const V square = fma<V>(g.x, g.x, fma<V>(g.y, g.y, g.z * g.z));
      squares += square;
      weight = fma<V>(w[i], square, weight);
    }
    V wanted = -e.c;
    V lambda{};
    if (k.soft) {
      const V alpha =
          compliance_.size() == 1 ? k.alpha : load_lanes(compliance_, b) * k.alpha_factor;
      if (k.load) {
        lambda = substep::load<V>(multiplier_[b].values);
        wanted -= alpha * lambda;
      }
      if (k.damped) {
        const V beta = damping_.size() == 1 ? k.beta : load_lanes(damping_, b);
        const V gamma = alpha * beta * k.gamma_factor;
        wanted -= gamma * approach(b, s, e);
        weight += gamma * weight;
      }
      weight += alpha;
    }
    auto active = (squares > 0) & (weight > 0);
    auto flat = (squares == 0) & (e.c != 0);  // without a gradient, but not satisfied
    if constexpr (Constraint::kInequality) {
      const auto violated = e.c < 0;
      active &= violated;
      flat &= violated;
    }
    if (any(flat)) {
      for_lanes(b, [&](std::size_t, std::size_t lane) { skipped += flat[lane] != 0; });
    }
    V dlambda = active ? wanted / (active ? weight : splat<V>(1)) : V{};
    if (k.scaled) dlambda *= stiffness_.size() == 1 ? k.stiffness : load_lanes(stiffness_, b);
    if constexpr (Constraint::kInequality) {
      dlambda = dlambda < -lambda ? -lambda : dlambda;  // it never pulls
    }
    return dlambda;
  }

  // grad C . (x - x_old): how far C has come in this substep.
  V approach(std::size_t b, const Sweep<Real>& s, const Evaluation& e) const {
    V sum{};
    for (std::size_t i = 0; i < kPoints; ++i) {
      const PointLanes<V> old = load_points<V>(s.x_old, blocks_[b].index[i]);
      sum = fma<V>(e.gradient[i].x, e.p[i].x - old.x, sum);
      sum = fma<V>(e.gradient[i].y, e.p[i].y - old.y, sum);
      sum = fma<V>(e.gradient[i].z, e.p[i].z - old.z, sum);
    }
    return sum;
  }

  SUBSTEP_INLINE void store_multiplier(std::size_t b, const Constants& k, const V& dlambda) {
    const V before = k.load ? substep::load<V>(multiplier_[b].values) : V{};
    const V sum = before + dlambda;
    std::memcpy(multiplier_[b].values, &sum, sizeof sum);
  }

  std::int64_t project_blocks(std::int64_t begin, std::int64_t end, const Sweep<Real>& s) {
    const Constants k(*this, s);
    std::int64_t skipped = 0;
    for (auto b = static_cast<std::size_t>(begin); b < static_cast<std::size_t>(end); ++b) {
      const Block& block = blocks_[b];
      Evaluation e;
      evaluate(block, s.x, e);
      std::array<V, kPoints> w;
      for (std::size_t i = 0; i < kPoints; ++i) w[i] = e.p[i].w;
      const V dlambda = update(b, s, k, w, e, skipped);
      if (k.store) store_multiplier(b, k, dlambda);
      const bool full = block.index[0][kLanes - 1] < s.count;
      for (std::size_t i = 0; i < kPoints; ++i) {
        const V scale = dlambda * w[i];
        e.p[i].x = fma<V>(e.gradient[i].x, scale, e.p[i].x);
        e.p[i].y = fma<V>(e.gradient[i].y, scale, e.p[i].y);
        e.p[i].z = fma<V>(e.gradient[i].z, scale, e.p[i].z);
        if (full) [[likely]] {
          store_points<V>(e.p[i], s.x, block.index[i]);
        } else {
          for_lanes(b, [&](std::size_t, std::size_t lane) {
            s.x[block.index[i][lane]] = {e.p[i].x[lane], e.p[i].y[lane], e.p[i].z[lane],
                                         e.p[i].w[lane]};
          });
        }
      }
    }
    return skipped;
  }

  std::vector<std::int32_t> particles_;  // until attach()
  std::vector<double> parameters_;
  Softness softness_;
  std::int64_t size_;
  double h_ = 0;
  Schedule schedule_;
  std::vector<Block> blocks_;
  std::vector<Lanes> compliance_, damping_, stiffness_, multiplier_;
  bool soft_ = false, damped_ = false, scaled_ = false;
  mutable std::vector<std::int32_t> holders_;  // made when Jacobi asks
};

}  // namespace substep::pbd
