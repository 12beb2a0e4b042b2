#include "substep/springs/incremental_potential.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::springs {
namespace {

constexpr std::int64_t kGrain = 2048;  // elements or vertices of a chunk

// How a contribution enters its sum: as it is, negated, or transposed.
enum How : std::int64_t { kPlus = 0, kMinus = 1, kTransposed = 2 };

double sum_in_order(std::int64_t n, int threads, const auto& part) {
  const std::int64_t chunks = n > 0 ? (n - 1) / kGrain + 1 : 0;
  std::vector<double> parts(usize(chunks));
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        parts[usize(begin / kGrain)] = part(begin, end);
      },
      threads);
  double sum = 0.0;
  for (const double value : parts) sum += value;
  return sum;
}

// Turns lists of (owner, source), in the order of sources, into lists per owner.
void sort_by_owner(const std::vector<std::pair<std::int64_t, std::int64_t>>& pairs,
                   std::int64_t owners, std::vector<std::int64_t>& starts,
                   std::vector<std::int64_t>& sources) {
  starts.assign(usize(owners) + 1, 0);
  for (const auto& [owner, source] : pairs) ++starts[owner + 1];
  for (std::int64_t i = 0; i < owners; ++i) starts[i + 1] += starts[i];
  sources.resize(pairs.size());
  std::vector<std::int64_t> next(starts.begin(), starts.end() - 1);
  for (const auto& [owner, source] : pairs) sources[next[owner]++] = source;
}

}  // namespace

IncrementalPotential::IncrementalPotential(std::span<const double> masses,
                                           std::span<const std::uint8_t> pinned,
                                           std::vector<std::shared_ptr<Term>> terms, int threads,
                                           std::unique_ptr<Bodies> bodies)
    : masses_(masses.begin(), masses.end()),
      pinned_(pinned.begin(), pinned.end()),
      terms_(std::move(terms)),
      threads_(threads),
      bodies_(std::move(bodies)) {
  if (pinned_.size() != masses_.size()) {
    throw InputError("pinned: expected one flag for each mass");
  }
  const auto roves = [](const auto& term) { return term->roves(); };
  fixed_ = usize(std::ranges::find_if(terms_, roves) - terms_.begin());
  std::int64_t gradients = 0, blocks = 0;
  for (const auto& term : terms_) {
    gradient_base_.push_back(gradients);
    block_base_.push_back(blocks);
    gradients += element_count(*term) * gradient_count(*term);
    blocks += element_count(*term) * block_count(*term);
  }
  element_gradients_.resize(usize(gradients));
  element_blocks_.resize(usize(blocks));
  lists_.assign(terms_.size() - fixed_, -1);
  roving_starts_.assign(masses_.size() + 1, 0);
  velocity_.resize(masses_.size());
  build_pattern();
  build_sources();
}

void IncrementalPotential::set_pinned(std::span<const std::uint8_t> pinned) {
  pinned_.assign(pinned.begin(), pinned.end());
}

void IncrementalPotential::build_pattern() {
  const std::int64_t n = vertices();
  std::vector<std::pair<std::int32_t, std::int32_t>> edges;  // (lower, higher)
  for (const auto& term : terms_) {
    if (term->roves()) continue;
    const int arity = term->arity();
    const auto ids = term->vertices();
    for (std::size_t e = 0; e < ids.size(); e += usize(arity)) {
      for (int a = 1; a < arity; ++a) {
        for (int b = 0; b < a; ++b) {
          const std::int32_t i = ids[e + a], j = ids[e + b];
          edges.emplace_back(std::min(i, j), std::max(i, j));
        }
      }
    }
  }
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  pattern_.starts.assign(usize(n) + 1, 0);
  pattern_.neighbours.reserve(edges.size());
  for (const auto& [i, j] : edges) {
    ++pattern_.starts[i + 1];
    pattern_.neighbours.push_back(j);
  }
  for (std::int64_t i = 0; i < n; ++i) pattern_.starts[i + 1] += pattern_.starts[i];
  pattern_.columns.reserve(usize(3 * n) + 1);
  pattern_.rows.reserve(usize(6 * n) + 9 * edges.size());
  for (std::int32_t i = 0; i < n; ++i) {
    for (std::int32_t c = 0; c < 3; ++c) {
      pattern_.columns.push_back(static_cast<std::int32_t>(pattern_.rows.size()));
      for (std::int32_t r = c; r < 3; ++r) pattern_.rows.push_back(3 * i + r);
      for (std::int32_t k = pattern_.starts[i]; k < pattern_.starts[i + 1]; ++k) {
        for (std::int32_t r = 0; r < 3; ++r)
          pattern_.rows.push_back(3 * pattern_.neighbours[k] + r);
      }
    }
  }
  pattern_.columns.push_back(static_cast<std::int32_t>(pattern_.rows.size()));
}

void IncrementalPotential::build_sources() {
  const std::int64_t n = vertices();
  std::vector<std::pair<std::int64_t, std::int64_t>> gradients, blocks;  // (owner, source)
  const auto slot = [&](std::int32_t i,
                        std::int32_t j) -> std::int64_t {  // of block (j, i), j >= i
    if (i == j) return pattern_.starts[i] + i;
    const auto first = pattern_.neighbours.begin() + pattern_.starts[i];
    const auto last = pattern_.neighbours.begin() + pattern_.starts[i + 1];
    return i + 1 + (std::lower_bound(first, last, j) - pattern_.neighbours.begin());
  };
  for (std::size_t t = 0; t < fixed_; ++t) {
    const Term& term = *terms_[t];
    const int arity = term.arity();
    const auto ids = term.vertices();
    for (std::int64_t e = 0; e < element_count(term); ++e) {
      const std::int32_t* v = ids.data() + e * arity;
      const std::int64_t g = gradient_base_[t] + e * gradient_count(term);
      const std::int64_t h = block_base_[t] + e * block_count(term);
      if (term.difference()) {
        gradients.emplace_back(v[0], 4 * g + kPlus);
        gradients.emplace_back(v[1], 4 * g + kMinus);
        blocks.emplace_back(slot(v[0], v[0]), 4 * h + kPlus);
        blocks.emplace_back(slot(v[1], v[1]), 4 * h + kPlus);
        blocks.emplace_back(slot(std::min(v[0], v[1]), std::max(v[0], v[1])), 4 * h + kMinus);
        continue;
      }
      for (int a = 0; a < arity; ++a) {
        gradients.emplace_back(v[a], 4 * (g + a) + kPlus);
        for (int b = 0; b <= a; ++b) {
          const std::int64_t source = 4 * (h + a * (a + 1) / 2 + b);
          if (v[a] >= v[b]) {
            blocks.emplace_back(slot(v[b], v[a]), source + kPlus);
          } else {
            blocks.emplace_back(slot(v[a], v[b]), source + kTransposed);
          }
        }
      }
    }
  }
  sort_by_owner(gradients, n, gradient_starts_, gradient_sources_);
  const std::int64_t slots = n + static_cast<std::int64_t>(pattern_.neighbours.size());
  sort_by_owner(blocks, slots, block_starts_, block_sources_);
}

void IncrementalPotential::find_elements(Positions x) {
  bool changed = false;
  for (std::size_t t = fixed_; t < terms_.size(); ++t) {
    terms_[t]->find(x);
    changed |= lists_[t - fixed_] != terms_[t]->lists();
  }
  if (!changed) return;
  std::int64_t gradients = gradient_base_[fixed_], blocks = block_base_[fixed_];
  std::vector<std::pair<std::int64_t, std::int64_t>> owned;  // (vertex, place)
  std::int64_t place = 0;
  for (std::size_t t = fixed_; t < terms_.size(); ++t) {
    gradient_base_[t] = gradients + place;
    block_base_[t] = blocks + place;
    for (const std::int32_t vertex : terms_[t]->vertices()) owned.emplace_back(vertex, place++);
  }
  element_gradients_.resize(usize(gradients + place));
  element_blocks_.resize(usize(blocks + place));
  sort_by_owner(owned, vertices(), roving_starts_, roving_sources_);
  for (std::size_t t = fixed_; t < terms_.size(); ++t) lists_[t - fixed_] = terms_[t]->lists();
}

void IncrementalPotential::begin_step(Positions x_n, Positions y, double h) {
  h_ = h;
  border_ = {};
  x_n_.assign(x_n.begin(), x_n.end());
  y_.assign(y.begin(), y.end());
  for (const auto& term : terms_) term->lag(x_n);
}

void IncrementalPotential::follow(Positions x, Positions dx) {
  for (const auto& term : terms_) {
    parallel_for(
        element_count(*term), kGrain,
        [&](std::int64_t begin, std::int64_t end) { term->follow(x, dx, begin, end); }, threads_);
  }
}

void IncrementalPotential::arrive() {
  for (const auto& term : terms_) {
    if (term->dissipative()) term->arrive(velocity_, 0, element_count(*term));
  }
}

// v = (x - x_n) / h, where a dissipative term asks for it.
void IncrementalPotential::set_velocity(Positions x) {
  if (std::none_of(terms_.begin(), terms_.end(), [](auto& t) { return t->dissipative(); })) return;
  for (std::size_t i = 0; i < velocity_.size(); ++i) velocity_[i] = (x[i] - x_n_[i]) / h_;
}

ContactElements IncrementalPotential::contact_elements() const {
  const std::size_t barrier = terms_.size() - 2, friction = terms_.size() - 1;
  return {element_gradients_.data() + gradient_base_[barrier],
          element_gradients_.data() + gradient_base_[friction],
          element_blocks_.data() + block_base_[barrier],
          element_blocks_.data() + block_base_[friction]};
}

double IncrementalPotential::sum_energies(const Term& term, Positions x) const {
  const std::int64_t n = element_count(term);
  if (!term.roves()) {
    return sum_in_order(n, threads_, [&](std::int64_t begin, std::int64_t end) {
      return term.energy(x, begin, end);
    });
  }
  double sum = 0.0;
  for (std::int64_t begin = 0, end; begin < n; begin = end) {
    end = term.part_end(begin, kGrain);
    sum += term.energy(x, begin, end);
  }
  return sum;
}

double IncrementalPotential::energy(Positions x) {
  place(x);
  find_elements(x);
  set_velocity(x);
  double sum = sum_in_order(vertices(), threads_, [&](std::int64_t begin, std::int64_t end) {
    double part = 0.0;
    for (std::int64_t i = begin; i < end; ++i) {
      if (!pinned_[i]) part += 0.5 * masses_[i] / (h_ * h_) * (x[i] - y_[i]).squaredNorm();
    }
    return part;
  });
  for (const auto& term : terms_) {
    sum += term->dissipative() ? h_ * sum_energies(*term, velocity_) : sum_energies(*term, x);
  }
  if (has_bodies(x)) sum += bodies_->energy(unknowns(x));
  return sum;
}

double IncrementalPotential::energy_rounding(Positions x) const {
  constexpr double kRounding = std::numeric_limits<double>::epsilon();
  return sum_in_order(vertices(), threads_, [&](std::int64_t begin, std::int64_t end) {
    double part = 0.0;
    for (std::int64_t i = begin; i < end; ++i) {
      if (pinned_[i]) continue;
      part += kRounding * masses_[i] / (h_ * h_) * (x[i] - y_[i]).norm() * x[i].norm();
    }
    return part;
  });
}

double IncrementalPotential::elastic_energy(Positions x) {
  find_elements(x);
  double sum = 0.0;
  for (const auto& term : terms_) {
    if (!term->dissipative()) sum += sum_energies(*term, x);
  }
  return sum;
}

void IncrementalPotential::evaluate(Positions x, Positions v, double kept, bool hessian) {
  for (std::size_t t = 0; t < terms_.size(); ++t) {
    const Term& term = *terms_[t];
    const Positions at = term.dissipative() ? v : x;
    parallel_for(
        element_count(term), kGrain,
        [&](std::int64_t begin, std::int64_t end) {
          Vec3* g = element_gradients_.data() + gradient_base_[t] + begin * gradient_count(term);
          Mat3* blocks = element_blocks_.data() + block_base_[t] + begin * block_count(term);
          term.derivatives(at, begin, end, kept, g, hessian ? blocks : nullptr);
          if (!hessian || !term.dissipative()) return;
          for (std::int64_t k = 0; k < (end - begin) * block_count(term); ++k) blocks[k] /= h_;
        },
        threads_);
  }
}

void IncrementalPotential::gather_gradient(std::span<Vec3> g, Positions x) const {
  parallel_for(
      vertices(), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          if (pinned_[i]) {
            g[i].setZero();
            continue;
          }
          Vec3 sum = masses_[i] / (h_ * h_) * (x[i] - y_[i]);
          for (std::int64_t k = gradient_starts_[i]; k < gradient_starts_[i + 1]; ++k) {
            const std::int64_t source = gradient_sources_[k];
            const Vec3& part = element_gradients_[source / 4];
            if (source % 4 == kPlus) {
              sum += part;
            } else {
              sum -= part;
            }
          }
          for (std::int64_t k = roving_starts_[i]; k < roving_starts_[i + 1]; ++k) {
            sum += element_gradients_[gradient_base_[fixed_] + roving_sources_[k]];
          }
          g[i] = sum;
        }
      },
      threads_);
}

void IncrementalPotential::gather_blocks(std::span<double> values) const {
  const auto sum_block = [&](std::int64_t slot) {
    Mat3 sum = Mat3::Zero();
    for (std::int64_t k = block_starts_[slot]; k < block_starts_[slot + 1]; ++k) {
      const std::int64_t source = block_sources_[k];
      const Mat3& part = element_blocks_[source / 4];
      if (source % 4 == kPlus) {
        sum += part;
      } else if (source % 4 == kMinus) {
        sum -= part;
      } else {
        sum += part.transpose();
      }
    }
    return sum;
  };
  parallel_for(
      vertices(), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          const std::int64_t slot = pattern_.starts[i] + i;
          double* column[3];
          for (int c = 0; c < 3; ++c) column[c] = values.data() + pattern_.columns[3 * i + c];
          Mat3 block = masses_[i] / (h_ * h_) * Mat3::Identity();
          if (!pinned_[i]) {
            Mat3 sum = sum_block(slot);
            for (std::int64_t k = roving_starts_[i]; k < roving_starts_[i + 1]; ++k) {
              sum += element_blocks_[block_base_[fixed_] + roving_sources_[k]];
            }
            block += sum;
          }
          for (int c = 0; c < 3; ++c) {
            for (int r = c; r < 3; ++r) *column[c]++ = block(r, c);
          }
          for (std::int32_t k = pattern_.starts[i]; k < pattern_.starts[i + 1]; ++k) {
            if (pinned_[i] || pinned_[pattern_.neighbours[k]]) {
              block.setZero();
            } else {
              block = sum_block(k + i + 1);
            }
            for (int c = 0; c < 3; ++c) {
              for (int r = 0; r < 3; ++r) *column[c]++ = block(r, c);
            }
          }
        }
      },
      threads_);
}

void IncrementalPotential::gradient(Positions x, std::span<Vec3> g) {
  place(x);
  find_elements(x);
  set_velocity(x);
  evaluate(x, velocity_, 1.0, false);
  gather_gradient(g, x);
  if (has_bodies(x)) bodies_->gradient(x, contact_elements(), g);
}

void IncrementalPotential::assemble(Positions x, double kept, std::span<Vec3> g,
                                    std::span<double> values) {
  place(x);
  find_elements(x);
  set_velocity(x);
  evaluate(x, velocity_, kept, true);
  gather_gradient(g, x);
  gather_blocks(values);
  if (!has_bodies(x)) return;
  bodies_->gradient(x, contact_elements(), g);
  border_ = bodies_->border(x, contact_elements(), kept);
}

double IncrementalPotential::step_bound(Positions x, Positions dx) const {
  double bound = 1.0;
  for (const auto& term : terms_) {
    bound = std::min(bound, term->step_bound(x, dx, 0, element_count(*term)));
  }
  if (!has_bodies(x)) return bound;
  return std::min(bound, bodies_->step_bound(x, dx, unknowns(x), unknowns(dx)));
}

void IncrementalPotential::forces(Positions x, Positions v, std::span<Vec3> f) {
  for (const auto& term : terms_) {
    if (term->dissipative()) term->lag(x);
  }
  evaluate(x, v, 1.0, false);
  for (std::int64_t i = 0; i < vertices(); ++i) {
    Vec3 sum = Vec3::Zero();
    for (std::int64_t k = gradient_starts_[i]; k < gradient_starts_[i + 1]; ++k) {
      const std::int64_t source = gradient_sources_[k];
      const Vec3& part = element_gradients_[source / 4];
      if (source % 4 == kPlus) {
        sum -= part;
      } else {
        sum += part;
      }
    }
    f[i] = sum;
  }
}

}  // namespace substep::springs
