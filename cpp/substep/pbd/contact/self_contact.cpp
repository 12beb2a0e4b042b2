#include "substep/pbd/contact/self_contact.h"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

using geometry::Vec3;

constexpr std::int64_t kPairsPerTask = 2048;
constexpr double kSlack = 0.25;   // in thicknesses: what constraints may do beyond the prediction
constexpr double kRest = 0.99;    // of the distance at rest, so that rounding exerts nothing
constexpr double kKept = 0.1;     // of a slab's width, or of the thickness where that is less
constexpr int kPushes = 20;       // passes over the meetings
constexpr int kPushedRounds = 5;  // of finding meetings; then nothing is pushed any more
constexpr int kRounds = 100;      // of finding meetings; then all follows the mean motion
constexpr int kHalvings = 6;      // of a vertex' own motion; then it has none

template <class Real>
void put(Point<Real>& p, const Vec3& v) {
  p.x = static_cast<Real>(v[0]);
  p.y = static_cast<Real>(v[1]);
  p.z = static_cast<Real>(v[2]);
}

template <class Real>
std::array<Vec3, 4> corners(const SurfacePair& pair, const Point<Real>* x) {
  return {xyz(x[pair.v[0]]), xyz(x[pair.v[1]]), xyz(x[pair.v[2]]), xyz(x[pair.v[3]])};
}

template <class Real>
std::array<Real, 3> rounded(const Vec3& n) {
  return {static_cast<Real>(n[0]), static_cast<Real>(n[1]), static_cast<Real>(n[2])};
}

template <class Real>
Vec3 wide(const std::array<Real, 3>& n) {
  return {static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2])};
}

}  // namespace

template <class Real>
SelfContact<Real>::SelfContact(std::vector<std::array<std::int32_t, 3>> faces,
                               std::vector<Vec3> rest, const SelfContactOptions& options)
    : faces_(std::move(faces)), rest_(std::move(rest)), options_(options) {}

template <class Real>
std::unique_ptr<Group<Real>> SelfContact<Real>::clone() const {
  auto copy = std::make_unique<SelfContact>(faces_, rest_, options_);
  for (const SurfacePairs<Real>& pairs : pairs_) {
    copy->pairs_.emplace_back(pairs.faces(), pairs.rest());
  }
  copy->passed_ = passed_;
  return copy;
}

template <class Real>
void SelfContact<Real>::attach(const Partition& partition) {
  const auto slot = [&](std::int32_t id) { return partition.slot[usize(id)]; };
  auto faces = faces_;
  for (auto& face : faces) {
    for (std::int32_t& v : face) v = slot(v);
  }
  std::vector<Vec3> rest(rest_.size());
  for (std::size_t id = 0; id < rest_.size(); ++id) {
    rest[usize(slot(static_cast<std::int32_t>(id)))] = rest_[id];
  }
  pairs_.clear();
  pairs_.emplace_back(std::move(faces), std::move(rest));
}

// From the mean motion; returns the largest.
template <class Real>
double SelfContact<Real>::take_deviations(const Sweep<Real>& s) {
  deviations_.resize(usize(s.count));
  double most = 0;
  for (const std::int32_t v : pairs_[0].vertices()) {
    const double deviation = (xyz(s.x[v]) - xyz(s.x_old[v]) - mean_).norm();
    deviations_[usize(v)] = static_cast<Real>(deviation);
    most = std::max(most, deviation);
  }
  return most;
}

// No if the paths of this substep leave the pair further apart: at first by how far its vertices
// stray from the mean motion, then by how far they stray from each other.
template <class Real>
bool SelfContact<Real>::could_come_within(const typename SurfacePairs<Real>::Candidate& c,
                                          double distance, const Sweep<Real>& s) const {
  const double least = pairs_[0].least_distance(c) - distance;
  if (least <= 0) return true;
  std::array<Real, 2> most{};
  for (std::int32_t k = 0; k < 4; ++k) {
    Real& side = most[k < c.pair.first ? 0 : 1];
    const auto v = usize(c.pair.v[usize(k)]);
    side = std::max(side, deviations_[v]);
  }
  if (static_cast<double>(most[0] + most[1]) * (1 + 1e-5) < least) return false;
  const auto way = [&](std::int32_t k) {
    const std::int32_t v = c.pair.v[usize(k)];
    return Vec3(xyz(s.x[v]) - xyz(s.x_old[v]));
  };
  double squared = 0;
  for (std::int32_t a = 0; a < c.pair.first; ++a) {
    const Vec3 own = way(a);
    for (std::int32_t b = c.pair.first; b < 4; ++b) {
      squared = std::max(squared, (own - way(b)).squaredNorm());
    }
  }
  return squared * (1 + 1e-5) >= least * least;
}

// keep(candidate, closest points when the substep began, list) for candidates, in their order.
template <class Real>
template <class Kept, class Keep>
void SelfContact<Real>::collect(std::vector<Kept>& kept, int threads, Keep&& keep) const {
  const auto candidates = pairs_[0].candidates();
  const auto n = static_cast<std::int64_t>(candidates.size());
  std::vector<std::vector<Kept>> parts(usize((n + kPairsPerTask - 1) / kPairsPerTask));
  parallel_for(
      n, kPairsPerTask,
      [&](std::int64_t begin, std::int64_t end) {
        auto& part = parts[usize(begin / kPairsPerTask)];
        for (std::int64_t k = begin; k < end; ++k) {
          keep(candidates[usize(k)], part);
        }
      },
      threads);
  for (const auto& part : parts) kept.insert(kept.end(), part.begin(), part.end());
}

template <class Real>
void SelfContact<Real>::prepare(const Sweep<Real>& s, int threads) {
  contacts_.clear();
  passed_ = 0;
  const auto vertices = pairs_[0].vertices();
  mean_ = Vec3::Zero();
  for (const std::int32_t v : vertices) mean_ += xyz(s.x[v]) - xyz(s.x_old[v]);
  if (vertices.empty() || !mean_.allFinite()) return;  // the solver will say so
  mean_ /= static_cast<double>(vertices.size());
  const double t = options_.thickness;
  limit_ = std::min(take_deviations(s) + kSlack * t, pairs_[0].mean_edge());
  reach_ = 2 * limit_ + (1 + kSlack) * t;
  pairs_[0].update(s.x_old, reach_, threads);
  collect(contacts_, threads, [&](const auto& candidate, std::vector<Contact>& list) {
    if (!could_come_within(candidate, (1 + kSlack) * t, s)) return;
    const SurfacePair& pair = candidate.pair;
    const Closest near = closest(pair, corners(pair, s.x_old));
    if (near.d == 0 || near.d >= reach_) return;
    const auto x = corners(pair, s.x);
    const double kept = std::min(t, kRest * candidate.rest_distance);
    double c = -kept;
    for (std::size_t i = 0; i < 4; ++i) c += near.w[i] * near.n.dot(x[i]);
    if (c >= kSlack * t) return;
    Contact contact{
        .pair = pair, .w = {}, .n = rounded<Real>(near.n), .thickness = static_cast<Real>(kept)};
    for (std::size_t i = 0; i < 4; ++i) contact.w[i] = static_cast<Real>(near.w[i]);
    list.push_back(contact);
  });
}

template <class Real>
std::int64_t SelfContact<Real>::project(int, std::int64_t, const Sweep<Real>& s) {
  const auto friction = static_cast<Real>(options_.friction);
  for (const Contact& contact : contacts_) {
    const auto& [w, n] = std::tie(contact.w, contact.n);
    std::array<Point<Real>*, 4> x;
    Real c = -contact.thickness, share = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      x[i] = s.x + contact.pair.v[i];
      c += w[i] * (n[0] * x[i]->x + n[1] * x[i]->y + n[2] * x[i]->z);
      share += w[i] * w[i] * x[i]->w;
    }
    if (!(c < 0) || !(share > 0)) continue;
    std::array<Real, 3> push{-c * n[0], -c * n[1], -c * n[2]};
    if (friction > 0) {
      std::array<Real, 3> way{};
      for (std::size_t i = 0; i < 4; ++i) {
        const Point<Real>& old = s.x_old[contact.pair.v[i]];
        way[0] += w[i] * (x[i]->x - old.x);
        way[1] += w[i] * (x[i]->y - old.y);
        way[2] += w[i] * (x[i]->z - old.z);
      }
      const Real along = way[0] * n[0] + way[1] * n[1] + way[2] * n[2];
      for (std::size_t k = 0; k < 3; ++k) way[k] -= along * n[k];
      const Real length = std::sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
      const Real part = friction * -c < length ? friction * -c / length : Real{1};
      for (std::size_t k = 0; k < 3; ++k) push[k] -= part * way[k];
    }
    for (std::size_t i = 0; i < 4; ++i) {
      const Real scale = w[i] * x[i]->w / share;
      x[i]->x += scale * push[0];
      x[i]->y += scale * push[1];
      x[i]->z += scale * push[2];
    }
  }
  return 0;
}

template <class Real>
typename SelfContact<Real>::Slab SelfContact<Real>::slab(const SurfacePair& pair,
                                                         const std::array<Real, 3>& n,
                                                         const Point<Real>* x) {
  const Vec3 direction = wide(n);
  const auto height = [&](std::int32_t k) { return direction.dot(xyz(x[pair.v[usize(k)]])); };
  Slab result{pair.v[0], pair.v[usize(pair.first)], 0};
  double high = height(0), low = height(pair.first);
  for (std::int32_t k = 1; k < 4; ++k) {
    const double h = height(k);
    if (k < pair.first && h < high) high = h, result.high = pair.v[usize(k)];
    if (k >= pair.first && h > low) low = h, result.low = pair.v[usize(k)];
  }
  result.width = high - low;
  return result;
}

template <class Real>
void SelfContact<Real>::limit(const Sweep<Real>& s, std::int32_t v) const {
  if (s.x[v].w == 0) return;
  const Vec3 start = xyz(s.x_old[v]) + mean_, own = xyz(s.x[v]) - start;
  const double length = own.norm();
  if (length > limit_) put(s.x[v], start + own * (limit_ / length));
}

// Adds pairs whose slab vanished; whether there are any.
template <class Real>
bool SelfContact<Real>::find_meetings(const Sweep<Real>& s, int threads) {
  take_deviations(s);
  const std::size_t before = meetings_.size();
  const double t = options_.thickness;
  collect(meetings_, threads, [&](const auto& candidate, std::vector<Meeting>& list) {
    if (!could_come_within(candidate, kKept * t, s)) return;
    const Closest near = closest(candidate.pair, corners(candidate.pair, s.x_old));
    const auto n = rounded<Real>(near.n);
    const double width = slab(candidate.pair, n, s.x_old).width;
    const double least = kKept * std::min(width, t);
    if (!(width > 0) || slab(candidate.pair, n, s.x).width >= least) return;  // 0: they touched
    list.push_back({candidate.pair, n, least});
  });
  return meetings_.size() > before;
}

// One pass; whether there was nothing to do.
template <class Real>
bool SelfContact<Real>::push_apart(const Sweep<Real>& s) const {
  bool apart = true;
  for (const Meeting& meeting : meetings_) {
    const Slab between = slab(meeting.pair, meeting.n, s.x);
    if (between.width >= meeting.least) continue;
    apart = false;
    Point<Real>& high = s.x[between.high];
    Point<Real>& low = s.x[between.low];
    const double sum = static_cast<double>(high.w) + static_cast<double>(low.w);
    if (sum == 0) continue;
    const Vec3 push = (2 * meeting.least - between.width) / sum * wide(meeting.n);
    put(high, xyz(high) + static_cast<double>(high.w) * push);
    put(low, xyz(low) - static_cast<double>(low.w) * push);
    limit(s, between.high);
    limit(s, between.low);
  }
  return apart;
}

// Until the meetings that there are have their slabs, or cannot.
template <class Real>
void SelfContact<Real>::bring_back(const Sweep<Real>& s) {
  for (int round = 0; round <= kHalvings * 4; ++round) {
    std::vector<std::int32_t> back;
    passed_ = 0;
    for (const Meeting& meeting : meetings_) {
      if (slab(meeting.pair, meeting.n, s.x).width >= meeting.least) continue;
      ++passed_;
      back.insert(back.end(), meeting.pair.v.begin(), meeting.pair.v.end());
    }
    if (passed_ == 0) return;
    std::sort(back.begin(), back.end());
    back.erase(std::unique(back.begin(), back.end()), back.end());
    for (const std::int32_t v : back) {
      int& halvings = halvings_[usize(v)];
      if (s.x[v].w == 0 || halvings > kHalvings) continue;
      const double part = ++halvings > kHalvings ? 0 : std::ldexp(1.0, -halvings);
      const Vec3 start = xyz(s.x_old[v]) + mean_;
      put(s.x[v], start + part * (xyz(wanted_[usize(v)]) - start));
    }
  }
}

template <class Real>
void SelfContact<Real>::complete(const Sweep<Real>& s, int threads) {
  const auto vertices = pairs_[0].vertices();
  for (const std::int32_t v : vertices) {
    if (!xyz(s.x[v]).allFinite()) return;  // the solver will say so
  }
  for (const std::int32_t v : vertices) limit(s, v);
  meetings_.clear();
  for (int round = 0; find_meetings(s, threads) && round < kRounds; ++round) {
    bool apart = false;
    if (round < kPushedRounds) {
      for (int pass = 0; pass < kPushes && !apart; ++pass) apart = push_apart(s);
      wanted_.assign(s.x, s.x + s.count);
      halvings_.assign(wanted_.size(), 0);
    }
    if (!apart) bring_back(s);
    if (passed_ > 0) return;
    if (round + 1 < kRounds) continue;
    for (const std::int32_t v : vertices) {
      if (s.x[v].w != 0) put(s.x[v], xyz(s.x_old[v]) + mean_);
    }
  }
}

template class SelfContact<float>;
template class SelfContact<double>;

}  // namespace substep::pbd
