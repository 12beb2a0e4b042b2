#include "substep/gridfluid/viscosity/rigid_blocks.h"

#include <algorithm>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::gridfluid {
namespace {

constexpr int kBlock = 4;         // cells along a block of the first level
constexpr int kDirect = 48;       // blocks that are solved for directly
constexpr double kEnlarge = 1.2;  // corrections, which blocks make too stiff
// Of a block with few faces some motions are none: they get this part of the mean of the others.
constexpr double kLeast = 1e-6;
constexpr std::int64_t kOfTask = 16;  // blocks

}  // namespace

template <int D>
auto RigidBlocks<D>::Level::at(std::int64_t block, std::int32_t with) -> Pair& {
  std::int64_t k = block * kNear;
  while (other[usize(k)] != with && other[usize(k)] >= 0) ++k;
  other[usize(k)] = with;
  return value[usize(k)];
}

template <int D>
auto RigidBlocks<D>::Level::others(std::int64_t block) const -> Motion {
  Motion sum = Motion::Zero();
  for (std::int64_t k = block * kNear; k < (block + 1) * kNear && other[usize(k)] >= 0; ++k) {
    if (other[usize(k)] != block) sum.noalias() += value[usize(k)] * x[usize(other[usize(k)])];
  }
  return sum;
}

template <int D>
void RigidBlocks<D>::Level::sweep(bool forwards, int threads) {
  for_colours(colours, forwards, kOfTask, threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i)
      x[usize(i)].noalias() = inverse[usize(i)] * (r[usize(i)] - others(i));
  });
}

template <int D>
template <class PlaceOf>
std::vector<std::int32_t> RigidBlocks<D>::group(std::int64_t items, const PlaceOf& place_of,
                                                const std::array<bool, D>& periodic,
                                                Level& level) const {
  const auto key_of = [&](const Place& place) {
    std::int64_t key = 0;
    for (std::size_t a = 0; a < D; ++a) key = key * level.extent[a] + place[a];
    return key;
  };
  // Blocks that meet differ by 1 along an axis, or are the first and the last of a periodic one.
  const auto colour_of = [&](const Place& place) {
    int colour = 0;
    for (std::size_t a = 0; a < D; ++a) {
      const int n = level.extent[a];
      const bool closes = periodic[a] && n % 2 == 1 && n > 1 && place[a] == n - 1;
      colour = 3 * colour + (closes ? 2 : place[a] % 2);
    }
    return colour;
  };
  std::int64_t room = 1;
  for (const int n : level.extent) room *= n;
  std::vector<std::int32_t> id(usize(room), -1), block_of(usize(items));
  std::array<std::vector<Place>, kNear> of_colour;
  for (std::int64_t i = 0; i < items; ++i) {
    const Place place = place_of(i);
    std::int32_t& known = id[usize(key_of(place))];
    if (known >= 0) continue;
    known = 0;
    of_colour[usize(colour_of(place))].push_back(place);
  }
  for (const std::vector<Place>& places : of_colour) {
    for (const Place& place : places) {
      id[usize(key_of(place))] = static_cast<std::int32_t>(level.place.size());
      level.place.push_back(place);
    }
    if (!places.empty()) level.colours.push_back(level.size());
  }
  std::vector<std::int64_t> begin(level.place.size() + 1);
  for (std::int64_t i = 0; i < items; ++i) {
    block_of[usize(i)] = id[usize(key_of(place_of(i)))];
    ++begin[usize(block_of[usize(i)] + 1)];
  }
  for (std::size_t b = 1; b < begin.size(); ++b) begin[b] += begin[b - 1];
  level.member.resize(usize(items));
  for (std::int64_t i = 0; i < items; ++i)
    level.member[usize(begin[usize(block_of[usize(i)])]++)] = static_cast<std::int32_t>(i);
  begin.pop_back();
  level.member_end = std::move(begin);
  return block_of;
}

// add(block, member) adds what a member has to the matrix.
template <int D>
template <class Add>
void RigidBlocks<D>::find_matrix(Level& level, const Add& add, int threads) const {
  const auto n = usize(level.size());
  level.other.assign(n * kNear, -1);
  level.value.assign(n * kNear, Pair::Zero());
  level.own.resize(n);
  level.inverse.resize(n);
  level.r.resize(n);
  level.x.resize(n);
  parallel_for(
      level.size(), kOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          for (std::int64_t m = b == 0 ? 0 : level.member_end[usize(b - 1)];
               m < level.member_end[usize(b)]; ++m) {
            add(b, level.member[usize(m)]);
          }
          Pair& own = level.at(b, static_cast<std::int32_t>(b));
          own.diagonal().array() += kLeast * own.trace() / kMotions;
          level.own[usize(b)] = own;
          level.inverse[usize(b)] = own.ldlt().solve(Pair::Identity());
        }
      },
      threads);
}

// The velocity of a face in the motions of its block.
template <int D>
auto RigidBlocks<D>::of_face(const VelocityRows<D>& rows, std::int64_t row, const Place& block)
    -> Motion {
  const std::size_t a = rows.component[usize(row)];
  std::array<double, D> x;  // from the middle of the block, over half of it
  for (std::size_t k = 0; k < D; ++k)
    x[k] = double(rows.place[usize(row)][k]) / (kBlock / 2.0) - 2 * block[k] - 1;
  Motion motion = Motion::Zero();
  motion[static_cast<int>(a)] = 1;
  if constexpr (D == 2) {
    motion[2] = a == 0 ? -x[1] : x[0];
  } else {
    const std::size_t b = (a + 1) % 3, c = (a + 2) % 3;
    motion[static_cast<int>(3 + b)] = x[c];
    motion[static_cast<int>(3 + c)] = -x[b];
  }
  return motion;
}

// The motion of a block from that of the block twice as large that it is in.
template <int D>
auto RigidBlocks<D>::of_parent(const Place& block) -> Pair {
  Pair motion = Pair::Identity();
  std::array<double, D> x;  // of its middle, over half of the large block
  for (std::size_t a = 0; a < D; ++a) x[a] = block[a] % 2 - 0.5;
  if constexpr (D == 2) {
    motion(0, 2) = -x[1];
    motion(1, 2) = x[0];
    motion(2, 2) = 0.5;
  } else {
    for (int a = 0; a < 3; ++a) {
      const int b = (a + 1) % 3, c = (a + 2) % 3;
      motion(a, 3 + b) = x[usize(c)];
      motion(a, 3 + c) = -x[usize(b)];
      motion(3 + a, 3 + a) = 0.5;
    }
  }
  return motion;
}

template <int D>
void RigidBlocks<D>::find(const VelocityRows<D>& rows, int threads) {
  levels_.assign(1, {});
  Level& level = levels_.front();
  for (std::size_t a = 0; a < D; ++a) level.extent[a] = (rows.cells[a] + kBlock - 1) / kBlock;
  const auto place_of = [&](std::int64_t row) {
    Place place;
    for (std::size_t a = 0; a < D; ++a) {
      const int cell = static_cast<int>(rows.place[usize(row)][a]);
      place[a] = std::min(cell / kBlock, level.extent[a] - 1);
    }
    return place;
  };
  block_of_.assign(1, group(rows.size(), place_of, rows.periodic, level));
  const std::vector<std::int32_t>& block = block_of_.front();
  find_matrix(
      level,
      [&](std::int64_t b, std::int64_t row) {
        const Motion own = of_face(rows, row, level.place[usize(b)]);
        level.at(b, static_cast<std::int32_t>(b)) +=
            own * (rows.diagonal[usize(row)] * own.transpose());
        for (std::int64_t k = row * rows.kWidth; k < (row + 1) * rows.kWidth; ++k) {
          const auto v = double(rows.value[usize(k)]);
          if (v == 0) continue;
          const std::int32_t other = rows.column[usize(k)], with = block[usize(other)];
          const Motion theirs = of_face(rows, other, level.place[usize(with)]);
          level.at(b, with) += own * (v * theirs.transpose());
        }
      },
      threads);
  while (levels_.back().size() > kDirect) coarsen(rows.periodic, threads);

  const Level& last = levels_.back();
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(last.size() * kMotions, last.size() * kMotions);
  for (std::int64_t b = 0; b < last.size(); ++b) {
    for (std::int64_t k = b * kNear; k < (b + 1) * kNear && last.other[usize(k)] >= 0; ++k) {
      matrix.block<kMotions, kMotions>(b * kMotions, last.other[usize(k)] * kMotions) =
          last.value[usize(k)];
    }
  }
  direct_.compute(matrix);
}

template <int D>
void RigidBlocks<D>::coarsen(const std::array<bool, D>& periodic, int threads) {
  levels_.emplace_back();
  Level& level = levels_.back();
  const Level& fine = levels_[levels_.size() - 2];
  for (std::size_t a = 0; a < D; ++a) level.extent[a] = (fine.extent[a] + 1) / 2;
  const auto place_of = [&](std::int64_t b) {
    Place place = fine.place[usize(b)];
    for (int& k : place) k /= 2;
    return place;
  };
  block_of_.push_back(group(fine.size(), place_of, periodic, level));
  const std::vector<std::int32_t>& block = block_of_.back();
  find_matrix(
      level,
      [&](std::int64_t b, std::int64_t m) {
        const Pair own = of_parent(fine.place[usize(m)]);
        for (std::int64_t k = m * kNear; k < (m + 1) * kNear && fine.other[usize(k)] >= 0; ++k) {
          const std::int32_t other = fine.other[usize(k)];
          level.at(b, block[usize(other)]) +=
              own.transpose() * fine.value[usize(k)] * of_parent(fine.place[usize(other)]);
        }
      },
      threads);
}

template <int D>
void RigidBlocks<D>::solve_last() {
  Level& level = levels_.back();
  Eigen::VectorXd r(level.size() * kMotions);
  for (std::int64_t b = 0; b < level.size(); ++b)
    r.segment<kMotions>(b * kMotions) = level.r[usize(b)];
  const Eigen::VectorXd x = direct_.solve(r);
  for (std::int64_t b = 0; b < level.size(); ++b)
    level.x[usize(b)] = x.segment<kMotions>(b * kMotions);
}

template <int D>
void RigidBlocks<D>::cycle(std::size_t l, int threads) {
  if (l + 1 == levels_.size()) return solve_last();
  Level &fine = levels_[l], &level = levels_[l + 1];
  std::fill(fine.x.begin(), fine.x.end(), Motion::Zero());
  fine.sweep(true, threads);
  parallel_for(
      level.size(), kOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          Motion sum = Motion::Zero();
          for (std::int64_t k = b == 0 ? 0 : level.member_end[usize(b - 1)];
               k < level.member_end[usize(b)]; ++k) {
            const std::int32_t m = level.member[usize(k)];
            Motion left = fine.r[usize(m)] - fine.others(m);
            left.noalias() -= fine.own[usize(m)] * fine.x[usize(m)];
            sum.noalias() += of_parent(fine.place[usize(m)]).transpose() * left;
          }
          level.r[usize(b)] = sum;
        }
      },
      threads);
  cycle(l + 1, threads);
  const std::vector<std::int32_t>& parent = block_of_[l + 1];
  for (std::int64_t m = 0; m < fine.size(); ++m) {
    fine.x[usize(m)].noalias() +=
        kEnlarge * of_parent(fine.place[usize(m)]) * level.x[usize(parent[usize(m)])];
  }
  fine.sweep(false, threads);
}

template <int D>
void RigidBlocks<D>::correct(const VelocityRows<D>& rows, std::span<const double> r,
                             std::span<double> x, int threads) {
  Level& level = levels_.front();
  parallel_for(
      level.size(), kOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          Motion sum = Motion::Zero();
          for (std::int64_t k = b == 0 ? 0 : level.member_end[usize(b - 1)];
               k < level.member_end[usize(b)]; ++k) {
            const std::int32_t row = level.member[usize(k)];
            sum += r[usize(row)] * of_face(rows, row, level.place[usize(b)]);
          }
          level.r[usize(b)] = sum;
        }
      },
      threads);
  cycle(0, threads);
  parallel_for(
      rows.size(), 64 * kOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t row = begin; row < end; ++row) {
          const auto b = usize(block_of_.front()[usize(row)]);
          x[usize(row)] += kEnlarge * of_face(rows, row, level.place[b]).dot(level.x[b]);
        }
      },
      threads);
}

template class RigidBlocks<2>;
template class RigidBlocks<3>;

}  // namespace substep::gridfluid
