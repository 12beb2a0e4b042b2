#include "substep/geometry/poisson_disk.h"

#include <algorithm>
#include <cmath>

#include "substep/core/parallel.h"
#include "substep/core/random.h"
#include "substep/core/usize.h"

namespace substep::geometry {
namespace {

constexpr float kEmpty = -1;
constexpr int kReach = 2;  // cells at which a point can be closer than sqrt(D) cells: ceil(sqrt(D))
constexpr int kApart = kReach + 1;
constexpr int kRounds = 8;                     // of the first trial
constexpr std::uint64_t kOrders = 1ull << 32;  // streams of random numbers that no dart has
// What rounding to float can hide of a squared distance, in cells.
constexpr float kSlack = 1e-5f;

// The cells with their points, as fractions of a cell; the first number of an empty one is kEmpty.
template <int D>
class Darts {
 public:
  Darts(const std::array<double, D>& size, double radius, std::uint64_t seed)
      : side_(radius / std::sqrt(static_cast<double>(D))), seed_(seed) {
    for (int d = 0; d < D; ++d) {
      extent_[d] = static_cast<float>(size[d] / side_);
      counts_[d] = std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(extent_[d])));
    }
    std::int64_t cells = 1;
    for (int d = D - 1; d >= 0; --d) {
      strides_[d] = cells;
      cells *= counts_[d];
    }
    points_.assign(usize(cells), filled(kEmpty));
    list_neighbours();
  }

  void throw_darts(int trials, int threads) {
    for (Turn turn{}; turn.trial < trials; ++turn.trial) {
      turn.rounds = turn.trial < 3 ? kRounds >> turn.trial : 1;
      for (turn.round = 0; turn.round < turn.rounds; ++turn.round) throw_round(turn, threads);
    }
  }

  std::vector<std::array<double, D>> points() const {
    std::vector<std::array<double, D>> out;
    Cell cell{};
    for (const Fraction& point : points_) {
      if (point[0] != kEmpty) {
        auto& x = out.emplace_back();
        for (int d = 0; d < D; ++d) {
          x[d] = side_ * (static_cast<double>(cell[d]) + static_cast<double>(point[d]));
        }
      }
      for (int d = D - 1; d >= 0 && ++cell[d] == counts_[d]; --d) cell[d] = 0;
    }
    return out;
  }

 private:
  using Cell = std::array<std::int64_t, D>;
  using Fraction = std::array<float, D>;
  struct Turn {
    int trial, round, rounds;
  };
  struct Neighbour {
    Cell offset;
    std::int64_t stride;
  };
  static constexpr int kPhases = D == 2 ? kApart * kApart : kApart * kApart * kApart;

  static Fraction filled(float value) {
    Fraction f;
    f.fill(value);
    return f;
  }
  static Cell residues(int phase) {
    Cell r;
    for (int d = 0; d < D; ++d, phase /= kApart) r[d] = phase % kApart;
    return r;
  }
  std::int64_t count(int d, std::int64_t residue) const {
    return (counts_[d] - residue + kApart - 1) / kApart;
  }

  // Nearest first, which most often say no.
  void list_neighbours() {
    const auto distance = [](const Neighbour& n) {
      std::int64_t sum = 0;
      for (const std::int64_t k : n.offset) sum += k * k;
      return sum;
    };
    Neighbour n{};
    n.offset.fill(-kReach);
    for (bool more = true; more;) {
      n.stride = 0;
      for (int d = 0; d < D; ++d) n.stride += n.offset[d] * strides_[d];
      std::int64_t gap = 0;  // squared, between the cells
      for (const std::int64_t k : n.offset) gap += k * k == kReach * kReach ? 1 : 0;
      if (distance(n) != 0 && gap < D) neighbours_.push_back(n);
      int d = D - 1;
      while (d >= 0 && ++n.offset[d] > kReach) n.offset[d--] = -kReach;
      more = d >= 0;
    }
    std::stable_sort(
        neighbours_.begin(), neighbours_.end(),
        [&](const Neighbour& a, const Neighbour& b) { return distance(a) < distance(b); });
  }

  void throw_round(const Turn& turn, int threads) {
    std::array<int, kPhases> order{};
    std::array<std::int64_t, kPhases> rows;  // all cells of a phase but the last axis
    for (int k = 0; k < kPhases; ++k) {      // a random order (Fisher and Yates)
      const double u =
          uniform2(seed_, static_cast<std::uint64_t>(kRounds * turn.trial + turn.round),
                   kOrders + static_cast<std::uint64_t>(k))[0];
      const int j = static_cast<int>(u * (k + 1));
      order[k] = order[j];
      order[j] = k;
    }
    for (int k = 0; k < kPhases; ++k) {
      const Cell first = residues(order[k]);
      rows[k] = 1;
      for (int d = 0; d + 1 < D; ++d) rows[k] *= count(d, first[d]);
    }
    parallel_phases(
        rows,
        [&](std::int64_t phase, std::int64_t row) {
          throw_at_row(residues(order[usize(phase)]), row, turn);
        },
        threads);
  }

  void throw_at_row(Cell cell, std::int64_t row, const Turn& turn) {
    for (int d = D - 2; d >= 0; --d) {
      const std::int64_t n = count(d, cell[d]);
      cell[d] += kApart * (row % n);
      row /= n;
    }
    for (; cell[D - 1] < counts_[D - 1]; cell[D - 1] += kApart) throw_at(cell, turn);
  }

  void throw_at(const Cell& cell, const Turn& turn) {
    std::int64_t index = 0;
    for (int d = 0; d < D; ++d) index += cell[d] * strides_[d];
    Fraction& own = points_[usize(index)];
    if (own[0] != kEmpty) return;
    const auto draw = [&](std::uint64_t k) {
      return uniform2(seed_, static_cast<std::uint64_t>(index),
                      2 * static_cast<std::uint64_t>(turn.trial) + k);
    };
    const auto later = draw(1);  // the third coordinate and the cell's round
    if (static_cast<int>(later[1] * turn.rounds) != turn.round) return;
    const auto u = draw(0);
    Fraction dart;
    for (int d = 0; d < D; ++d) dart[d] = static_cast<float>(d < 2 ? u[d] : later[0]);
    for (int d = 0; d < D; ++d) {
      if (static_cast<float>(cell[d]) + dart[d] > extent_[d]) return;
    }
    bool interior = true;
    for (int d = 0; d < D; ++d) {
      interior = interior && cell[d] >= kReach && cell[d] < counts_[d] - kReach;
    }
    const Fraction* const here = &own;
    for (const Neighbour& n : neighbours_) {
      if ((interior || exists(cell, n)) && near(dart, n, here[n.stride])) return;
    }
    own = dart;
  }

  bool exists(const Cell& cell, const Neighbour& n) const {
    bool inside = true;
    for (int d = 0; d < D; ++d) {
      const std::int64_t at = cell[d] + n.offset[d];
      inside = inside && at >= 0 && at < counts_[d];
    }
    return inside;
  }

  static bool near(const Fraction& dart, const Neighbour& n, const Fraction& other) {
    if (other[0] == kEmpty) return false;
    float squared = 0;
    for (int d = 0; d < D; ++d) {
      const float difference = other[d] - dart[d] + static_cast<float>(n.offset[d]);
      squared += difference * difference;
    }
    return squared < static_cast<float>(D) + kSlack;
  }

  double side_;
  std::uint64_t seed_;
  std::array<float, D> extent_;  // of the box, in cells
  Cell counts_, strides_;
  std::vector<Fraction> points_;
  std::vector<Neighbour> neighbours_;
};

}  // namespace

template <int D>
std::vector<std::array<double, D>> poisson_disk(const std::array<double, D>& size, double radius,
                                                int trials, std::uint64_t seed, int threads) {
  Darts<D> darts(size, radius, seed);
  darts.throw_darts(trials, threads);
  return darts.points();
}

template std::vector<std::array<double, 2>> poisson_disk<2>(const std::array<double, 2>&, double,
                                                            int, std::uint64_t, int);
template std::vector<std::array<double, 3>> poisson_disk<3>(const std::array<double, 3>&, double,
                                                            int, std::uint64_t, int);

}  // namespace substep::geometry
