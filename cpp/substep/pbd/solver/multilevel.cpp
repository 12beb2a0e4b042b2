#include "substep/pbd/solver/multilevel.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "substep/core/matrix3.h"
#include "substep/core/parallel.h"
#include "substep/core/point_lanes.h"
#include "substep/core/point_scatter.h"
#include "substep/core/usize.h"

namespace substep::pbd {
namespace {

constexpr std::int64_t kPatch = 1024;     // coarse particles
constexpr std::int64_t kRowGrain = 2048;  // particles in a chunk of a loop over them
constexpr std::int64_t kBlockGrain = 64;  // blocks of constraints in one
constexpr std::int64_t kFewest = 8;       // free particles of the coarsest level, about
constexpr double kLeastReduction = 0.8;   // of free particles from level to level
constexpr int kFirstSweeps = 2,
              kMostSweeps = 16;  // of the finest coarse level; doubles to the most

// A position and the number beside it.
template <class Real>
using Row = Vector<Real, 4 * sizeof(Real)>;

template <class V>
SUBSTEP_INLINE void store(const V& v, Lane<V>* to) {
  std::memcpy(to, &v, sizeof v);
}

template <class V>
SUBSTEP_INLINE V distance(const PointLanes<V>& p, const PointLanes<V>& q) {
  const V dx = p.x - q.x, dy = p.y - q.y, dz = p.z - q.z;
  return square_root<V>(fma<V>(dx, dx, fma<V>(dy, dy, dz * dz)));
}

std::int64_t chunks_of(std::int64_t n, std::int64_t grain) { return (n + grain - 1) / grain; }

}  // namespace

template <class Real>
Multilevel<Real>::Multilevel(std::vector<DistanceGraph::Edge> edges,
                             std::vector<std::array<double, 3>> rest)
    : edges_(std::move(edges)), rest_(std::move(rest)) {
  for (std::size_t i = rest_.size(); i-- > 0;) {
    for (std::size_t k = 0; k < 3; ++k) rest_[i][k] -= rest_[0][k];
  }
}

template <class Real>
void Multilevel<Real>::attach(const Partition& partition) {
  partition_ = partition;
}

template <class Real>
std::vector<std::int64_t> Multilevel<Real>::level_sizes() const {
  std::vector<std::int64_t> sizes{static_cast<std::int64_t>(rest_.size())};
  for (const Level& level : levels_) sizes.push_back(level.size);
  return sizes;
}

template <class Real>
std::int64_t Multilevel<Real>::project(const Sweep<Real>& s, int threads) {
  if (s.substep == 0 && s.iteration == 0) {
    bool same = !inverse_mass_.empty();
    for (std::size_t i = 0; same && i < inverse_mass_.size(); ++i) {
      same = inverse_mass_[i] == s.x[i].w;
    }
    if (!same) build(s);
  }
  parallel_phases(
      chunks_,
      [&](std::int64_t phase, std::int64_t chunk) { work(phases_[usize(phase)], chunk, s); },
      threads);
  return 0;
}

// The hierarchy, for the masses and pins of now.
template <class Real>
void Multilevel<Real>::build(const Sweep<Real>& s) {
  inverse_mass_.clear();  // until the levels are whole
  std::vector<Real> inverse_mass(usize(s.count));
  DistanceGraph graph;
  graph.rest = rest_;
  graph.edges = edges_;
  graph.mass.resize(rest_.size());
  for (std::size_t slot = 0; slot < inverse_mass.size(); ++slot) {
    const Real w = inverse_mass[slot] = s.x[slot].w;
    graph.mass[usize(partition_.id[slot])] = w > 0 ? 1 / static_cast<double>(w) : 0;
  }
  find_directions(graph);
  levels_.clear();
  Partition fine = partition_;
  std::vector<std::int32_t> place;  // of each fine edge: where its strain is
  while (graph.free() > kFewest && !graph.edges.empty()) {
    Coarsening c = coarsen(graph);
    if (c.coarse.edges.empty()) break;
    if (static_cast<double>(c.coarse.free()) >
        kLeastReduction * static_cast<double>(graph.free())) {
      break;
    }
    std::vector<Point<Real>> rest;
    for (const auto& p : c.coarse.rest) {
      rest.push_back(
          {static_cast<Real>(p[0]), static_cast<Real>(p[1]), static_cast<Real>(p[2]), 0});
    }
    Partition coarse = make_partition<Real>(std::span<const Point<Real>>(rest), kPatch);
    add_level(c, graph, fine, coarse, place);
    graph = std::move(c.coarse);
    fine = std::move(coarse);
  }
  list_phases();
  inverse_mass_ = std::move(inverse_mass);
}

template <class Real>
void Multilevel<Real>::add_level(const Coarsening& c, const DistanceGraph& fine_graph,
                                 const Partition& fine, const Partition& coarse,
                                 std::vector<std::int32_t>& place) {
  Level level;
  level.size = c.coarse.size();
  level.sweeps = std::min(kFirstSweeps << levels_.size(), kMostSweeps);
  const auto n = usize(level.size);
  level.x.assign(n + 1, {});
  level.before.assign(n + 1, {});
  const auto rows = [](const Rows& from, const Partition& order, const Partition& columns, Rows& to,
                       auto&& each) {
    for (const std::int32_t id : order.id) {
      const auto row = usize(id);
      for (std::int32_t k = from.start[row]; k < from.start[row + 1]; ++k) {
        const auto at = usize(k);
        to.index.push_back(columns.slot[usize(from.index[at])]);
        each(at);
      }
      to.start.push_back(static_cast<std::int32_t>(to.index.size()));
    }
  };
  rows(c.members, coarse, fine, level.members, [&](std::size_t k) {
    level.member_weight.push_back(static_cast<Real>(c.member_weight[k]));
  });
  rows(c.followed, fine, coarse, level.followed, [](std::size_t) {});
  for (std::size_t i = 0; i + 1 < level.followed.start.size(); ++i) {
    const std::int32_t count = level.followed.start[i + 1] - level.followed.start[i];
    level.inverse_count.push_back(count > 0 ? 1 / static_cast<Real>(count) : 0);
  }
  for (std::size_t slot = 0; slot < n; ++slot) {
    const double mass = c.coarse.mass[usize(coarse.id[slot])];
    level.x[slot].w = mass > 0 ? static_cast<Real>(1 / mass) : 0;
  }
  add_constraints(c, fine_graph, fine, coarse, place, level);
  levels_.push_back(std::move(level));
}

template <class Real>
void Multilevel<Real>::add_constraints(const Coarsening& c, const DistanceGraph& fine_graph,
                                       const Partition& fine, const Partition& coarse,
                                       std::vector<std::int32_t>& place, Level& level) {
  std::vector<std::int32_t> ends;
  for (const auto& e : c.coarse.edges) {
    ends.push_back(coarse.slot[usize(e.i)]);
    ends.push_back(coarse.slot[usize(e.j)]);
  }
  level.schedule = make_schedule(ends, 2, kLanes, coarse);
  const std::vector<std::int32_t>& order = level.schedule.constraint;
  level.blocks.assign(order.size() / kLanes, Block{});
  level.paths.assign(level.blocks.size(), Path{});
  level.strain.assign(order.size(), 0);
  std::vector<std::int32_t> own_place(c.coarse.edges.size());
  for (std::size_t k = 0; k < order.size(); ++k) {
    Block& block = level.blocks[k / kLanes];
    Path& path = level.paths[k / kLanes];
    const std::size_t lane = k % kLanes;
    if (order[k] < 0) {
      block.end[0][lane] = block.end[1][lane] = static_cast<std::int32_t>(level.size);
      continue;
    }
    const auto e = usize(order[k]);
    own_place[e] = static_cast<std::int32_t>(k);
    block.end[0][lane] = ends[2 * e];
    block.end[1][lane] = ends[2 * e + 1];
    block.rest[lane] = static_cast<Real>(c.coarse.edges[e].length);
    const auto length = [&](std::size_t step) {
      const std::int32_t edge = c.path[e][step];
      return edge < 0 ? 0 : fine_graph.edges[usize(edge)].length;
    };
    double sum = 0;
    for (std::size_t p = 0; p < kSteps; ++p) sum += length(p);
    path.inverse_length[lane] = static_cast<Real>(1 / sum);
    for (std::size_t p = 0; p < kSteps + 1; ++p) {
      if (levels_.empty()) {
        path.index[p][lane] = fine.slot[usize(c.path_points[e][p])];
      } else if (p < kSteps && c.path[e][p] >= 0) {
        path.index[p][lane] = place[usize(c.path[e][p])];
      }
      if (p < kSteps) path.weight[p][lane] = static_cast<Real>(length(p) / sum);
    }
  }
  place = std::move(own_place);
}

// Down: centres of mass and what their distances shall be; up: sweeps, and displacements handed on.
template <class Real>
void Multilevel<Real>::list_phases() {
  phases_.clear();
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    phases_.push_back({Kind::average, l, 0, chunks_of(levels_[l].size, kRowGrain)});
    phases_.push_back(
        {Kind::aim, l, 0,
         chunks_of(static_cast<std::int64_t>(levels_[l].blocks.size()), kBlockGrain)});
  }
  for (std::size_t l = levels_.size(); l-- > 0;) {
    const Schedule& schedule = levels_[l].schedule;
    for (int sweep = 0; sweep < levels_[l].sweeps; ++sweep) {
      const auto patches = static_cast<std::int64_t>(schedule.patch_start.size()) - 1;
      phases_.push_back({Kind::patches, l, 0, patches});
      for (int f = 0; f < schedule.phases(); ++f) {
        const auto at = usize(f);
        phases_.push_back(
            {Kind::between, l, f, schedule.phase_start[at + 1] - schedule.phase_start[at]});
      }
    }
    const auto finer = static_cast<std::int64_t>(levels_[l].inverse_count.size());
    phases_.push_back({Kind::follow, l, 0, chunks_of(finer, kRowGrain)});
  }
  chunks_.clear();
  for (const Phase& phase : phases_) chunks_.push_back(phase.chunks);
}

template <class Real>
void Multilevel<Real>::work(const Phase& phase, std::int64_t chunk, const Sweep<Real>& s) {
  Level& level = levels_[phase.level];
  const auto range = [&](std::int64_t n, std::int64_t grain, auto&& task) {
    task(chunk * grain, std::min(n, (chunk + 1) * grain));
  };
  switch (phase.kind) {
    case Kind::average:
      return range(level.size, kRowGrain, [&](std::int64_t begin, std::int64_t end) {
        average(phase.level, begin, end, s);
      });
    case Kind::aim:
      return range(static_cast<std::int64_t>(level.blocks.size()), kBlockGrain,
                   [&](std::int64_t begin, std::int64_t end) { aim(phase.level, begin, end, s); });
    case Kind::patches: {
      const auto p = usize(chunk);
      return sweep(level, level.schedule.patch_start[p], level.schedule.patch_start[p + 1]);
    }
    case Kind::between: {
      const auto c = usize(level.schedule.phase_start[usize(phase.group_phase)] + chunk);
      return sweep(level, level.schedule.chunk_start[c], level.schedule.chunk_start[c + 1]);
    }
    case Kind::follow:
      return range(
          static_cast<std::int64_t>(level.inverse_count.size()), kRowGrain,
          [&](std::int64_t begin, std::int64_t end) { follow(phase.level, begin, end, s); });
  }
}

// X_I = sum_i (m_i / k_i) x_i / M_I.
template <class Real>
void Multilevel<Real>::average(std::size_t l, std::int64_t begin, std::int64_t end,
                               const Sweep<Real>& s) {
  Level& level = levels_[l];
  const Point<Real>* const fine = l == 0 ? s.x : levels_[l - 1].x.data();
  for (auto i = usize(begin); i < usize(end); ++i) {
    Row<Real> sum{};
    for (std::int32_t k = level.members.start[i]; k < level.members.start[i + 1]; ++k) {
      const auto at = usize(k);
      sum += level.member_weight[at] * load<Row<Real>>(&fine[level.members.index[at]].x);
    }
    sum[3] = level.x[i].w;
    store(sum, &level.x[i].x);
    store(sum, &level.before[i].x);
  }
}

// The strain e of each path, and where the ends of the coarse constraint shall go for it.
template <class Real>
void Multilevel<Real>::aim(std::size_t l, std::int64_t begin, std::int64_t end,
                           const Sweep<Real>& s) {
  Level& level = levels_[l];
  const Real* const finer = l == 0 ? nullptr : levels_[l - 1].strain.data();
  for (auto b = usize(begin); b < usize(end); ++b) {
    Block& block = level.blocks[b];
    const Path& path = level.paths[b];
    V strain{};
    if (l == 0) {
      V length{};
      PointLanes<V> p = load_points<V>(s.x, path.index[0]);
      for (std::size_t k = 1; k <= kSteps; ++k) {
        const PointLanes<V> q = load_points<V>(s.x, path.index[k]);
        length += distance(p, q);
        p = q;
      }
      strain = length * load<V>(path.inverse_length) - 1;
    } else {
      for (std::size_t k = 0; k < kSteps; ++k) {
        V e;
        for (std::size_t lane = 0; lane < kLanes; ++lane) e[lane] = finer[path.index[k][lane]];
        strain += load<V>(path.weight[k]) * e;
      }
    }
    const V now = distance(load_points<V>(level.x.data(), block.end[0]),
                           load_points<V>(level.x.data(), block.end[1]));
    const V rest = load<V>(block.rest), aimed = now / (1 + strain);
    const V low = now < rest ? now : rest, high = now < rest ? rest : now;
    store(aimed < low ? low : aimed > high ? high : aimed, block.target);
    store(strain, &level.strain[b * kLanes]);
  }
}

// Gauss-Seidel on |X_I - X_J| = target (Mueller et al. 2007, section 3.3).
template <class Real>
void Multilevel<Real>::sweep(Level& level, std::int64_t begin, std::int64_t end) {
  for (auto b = usize(begin); b < usize(end); ++b) {
    const Block& block = level.blocks[b];
    PointLanes<V> p = load_points<V>(level.x.data(), block.end[0]);
    PointLanes<V> q = load_points<V>(level.x.data(), block.end[1]);
    const V length = distance(p, q), scale = length * (p.w + q.w);
    const V lambda =
        scale > 0 ? (load<V>(block.target) - length) / (scale > 0 ? scale : splat<V>(1)) : V{};
    const V dx = p.x - q.x, dy = p.y - q.y, dz = p.z - q.z;
    const V a = lambda * p.w, b2 = -lambda * q.w;
    p = {fma<V>(a, dx, p.x), fma<V>(a, dy, p.y), fma<V>(a, dz, p.z), p.w};
    q = {fma<V>(b2, dx, q.x), fma<V>(b2, dy, q.y), fma<V>(b2, dz, q.z), q.w};
    store_points(p, level.x.data(), block.end[0]);
    store_points(q, level.x.data(), block.end[1]);
  }
}

// x_i += (1 / k_i) sum_I dX_I.
template <class Real>
void Multilevel<Real>::follow(std::size_t l, std::int64_t begin, std::int64_t end,
                              const Sweep<Real>& s) {
  const Level& level = levels_[l];
  Point<Real>* const fine = l == 0 ? s.x : levels_[l - 1].x.data();
  for (auto i = usize(begin); i < usize(end); ++i) {
    if (!(fine[i].w > 0)) continue;
    Row<Real> sum{};
    for (std::int32_t k = level.followed.start[i]; k < level.followed.start[i + 1]; ++k) {
      const auto at = usize(level.followed.index[usize(k)]);
      sum += load<Row<Real>>(&level.x[at].x) - load<Row<Real>>(&level.before[at].x);
    }
    sum = fma<Row<Real>>(level.inverse_count[i], sum, load<Row<Real>>(&fine[i].x));
    store(sum, &fine[i].x);
  }
}

template class Multilevel<float>;
template class Multilevel<double>;

}  // namespace substep::pbd
