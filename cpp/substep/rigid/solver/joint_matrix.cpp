#include "substep/rigid/solver/joint_matrix.h"

#include <algorithm>
#include <cstring>
#include <set>
#include <type_traits>
#include <utility>

#include "substep/core/lanes.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr int kSize = JointMatrix::kSize;
using Four = Vector<double, 32>;

// Of blocks and vectors, see JointMatrix::Block: two vectors of four.
struct Pair {
  Four top, bottom;

  SUBSTEP_INLINE Pair() : top(Four{}), bottom(Four{}) {}
  SUBSTEP_INLINE explicit Pair(const double* from)
      : top(load<Four>(from)), bottom(load<Four>(from + 4)) {}
  SUBSTEP_INLINE void store(double* to) const {
    std::memcpy(to, &top, sizeof top), std::memcpy(to + 4, &bottom, sizeof bottom);
  }
  SUBSTEP_INLINE void add(double factor, const Pair& x) {
    const Four f = splat<Four>(factor);
    top = fma<Four>(f, x.top, top), bottom = fma<Four>(f, x.bottom, bottom);
  }
  SUBSTEP_INLINE double get(int row) const { return row < 4 ? top[row] : bottom[row - 4]; }
  SUBSTEP_INLINE void set(int row, double x) {
    if (row < 4)
      top[row] = x;
    else
      bottom[row - 4] = x;
  }
};

// task(std::integral_constant<int, n>) for 1 <= n <= 6: loops of known length stay in registers.
template <class F>
SUBSTEP_INLINE void with_size(int n, const F& task) {
  const auto call = [&]<int kN>() { task(std::integral_constant<int, kN>{}); };
  switch (n) {
    case 1:
      return call.template operator()<1>();
    case 2:
      return call.template operator()<2>();
    case 3:
      return call.template operator()<3>();
    case 4:
      return call.template operator()<4>();
    case 5:
      return call.template operator()<5>();
    default:
      return call.template operator()<6>();
  }
}

// The inverse of a definite block, by Gauss and Jordan without pivoting. (Exchanging pivots: Beaton
// 1964, the sweep operator; of definite matrices all pivots have the sign of D.)
template <int kN>
void invert(double* D) {
  Pair x[kN];
#pragma GCC unroll 6
  for (int c = 0; c < kN; ++c) x[c] = Pair(D + 8 * c);
#pragma GCC unroll 6
  for (int k = 0; k < kN; ++k) {
    const double inverse = 1 / x[k].get(k);
    const Pair column = x[k];
#pragma GCC unroll 6
    for (int c = 0; c < kN; ++c) {
      if (c == k) continue;
      const double factor = x[c].get(k) * inverse;
      x[c].add(-factor, column);
      x[c].set(k, factor);
    }
    x[k] = Pair();
    x[k].add(-inverse, column);
    x[k].set(k, inverse);
  }
#pragma GCC unroll 6
  for (int c = 0; c < kN; ++c) x[c].store(D + 8 * c);
}

// to = A B, A of kN columns, B of `columns` columns; all in the form of blocks.
template <int kN>
void multiply(const double* A, const double* B, int columns, double* to) {
  Pair a[kN];
#pragma GCC unroll 6
  for (int k = 0; k < kN; ++k) a[k] = Pair(A + 8 * k);
  for (int c = 0; c < columns; ++c, B += 8, to += 8) {
    Pair sum;
#pragma GCC unroll 6
    for (int k = 0; k < kN; ++k) sum.add(B[k], a[k]);
    sum.store(to);
  }
}

// to -= A B^T, of `columns` rows of B.
template <int kN>
void subtract(const double* A, const double* B, int columns, double* to) {
  Pair a[kN];
#pragma GCC unroll 6
  for (int k = 0; k < kN; ++k) a[k] = Pair(A + 8 * k);
  for (int c = 0; c < columns; ++c, to += 8) {
    Pair left(to);
#pragma GCC unroll 6
    for (int k = 0; k < kN; ++k) left.add(-B[8 * k + c], a[k]);
    left.store(to);
  }
}

// y += s A x: even and odd columns apart, so that they need not wait for each other.
template <int kN>
SUBSTEP_INLINE void add_product(double s, const double* A, const double* x, Pair& y) {
  Pair odd;
#pragma GCC unroll 6
  for (int k = 0; k < kN; ++k) (k % 2 == 0 ? y : odd).add(s * x[k], Pair(A + 8 * k));
  y.top = y.top + odd.top, y.bottom = y.bottom + odd.bottom;
}

// A^T x, of six columns.
SUBSTEP_INLINE Pair transposed_product(const double* A, const Pair& x) {
  Four sum[kSize];
#pragma GCC unroll 6
  for (int k = 0; k < kSize; ++k) {
    const Pair column(A + 8 * k);
    sum[k] = fma<Four>(column.bottom, x.bottom, column.top * x.top);
  }
  const auto sums = [](const Four& a, const Four& b, const Four& c, const Four& d) {
    const Four ab =
        __builtin_shufflevector(a, b, 0, 4, 2, 6) + __builtin_shufflevector(a, b, 1, 5, 3, 7);
    const Four cd =
        __builtin_shufflevector(c, d, 0, 4, 2, 6) + __builtin_shufflevector(c, d, 1, 5, 3, 7);
    return Four(__builtin_shufflevector(ab, cd, 0, 1, 4, 5) +
                __builtin_shufflevector(ab, cd, 2, 3, 6, 7));
  };
  Pair y = x;
  y.top = sums(sum[0], sum[1], sum[2], sum[3]);
  y.bottom = sums(sum[4], sum[5], Four{}, Four{});
  return y;
}

}  // namespace

void JointMatrix::analyse(std::int32_t bodies, std::span<const BodyPair> joints,
                          std::span<const int> rows) {
  bodies_ = bodies;
  const std::size_t nodes = usize(bodies) + joints.size();
  size_.assign(nodes, kSize);
  std::vector<std::vector<std::int32_t>> near(nodes);
  std::vector<int> waits(nodes, 0);  // a joint, for so many bodies
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const auto id = static_cast<std::int32_t>(usize(bodies) + j);
    size_[usize(id)] = std::max(rows[j], 1);  // of no rows: one that is not set
    for (const std::int32_t body : {joints[j].a, joints[j].b}) {
      if (body < 0) continue;
      near[usize(id)].push_back(body);
      near[usize(body)].push_back(id);
      ++waits[usize(id)];
    }
  }
  for (auto& list : near) std::sort(list.begin(), list.end());
  const auto joined = near;
  std::vector<std::uint8_t> done(nodes, 0);

  // Degree, 0 of bodies that have one joint; node.
  std::set<std::pair<std::size_t, std::int32_t>> queue;
  const auto is_leaf = [&](std::int32_t id) { return id < bodies && joined[usize(id)].size() < 2; };
  const auto key = [&](std::int32_t id) {
    return std::pair(is_leaf(id) ? 0 : near[usize(id)].size(), id);
  };
  const auto enter = [&](std::int32_t id) {
    if (waits[usize(id)] == 0) queue.insert(key(id));
  };
  for (std::size_t id = 0; id < nodes; ++id) enter(static_cast<std::int32_t>(id));
  order_.clear();
  below_.clear();
  std::vector<std::int32_t> merged;
  while (!queue.empty()) {
    const std::int32_t id = queue.begin()->second;
    queue.erase(queue.begin());
    done[usize(id)] = 1;
    const auto later = std::move(near[usize(id)]);
    if (id < bodies) {
      const auto& own = joined[usize(id)];
      const auto left = std::count_if(own.begin(), own.end(),
                                      [&](std::int32_t j) { return done[usize(j)] == 0; });
      for (const std::int32_t j : own)
        waits[usize(j)] = left == 1 ? 0 : std::max(waits[usize(j)] - 1, 0);
    }
    order_.push_back({id, size_[usize(id)], static_cast<std::int32_t>(below_.size()),
                      static_cast<std::int32_t>(later.size())});
    for (const std::int32_t other : later) {
      below_.push_back({other, -1});
      auto& list = near[usize(other)];
      queue.erase(key(other));
      merged.clear();
      std::set_union(list.begin(), list.end(), later.begin(), later.end(),
                     std::back_inserter(merged));
      std::erase_if(merged, [&](std::int32_t k) { return k == id || k == other; });
      list = merged;
      enter(other);
    }
  }
  units_ = std::find_if_not(order_.begin(), order_.end(),
                            [&](const Node& node) { return is_leaf(node.id); }) -
           order_.begin();
  place(joints);
}

void JointMatrix::place(std::span<const BodyPair> joints) {
  std::vector<std::int32_t> position(order_.size());
  for (std::size_t k = 0; k < order_.size(); ++k)
    position[usize(order_[k].id)] = static_cast<std::int32_t>(k);
  const auto sooner = [&](const Below& x, std::int32_t id) {
    return position[usize(x.id)] < position[usize(id)];
  };
  const auto belows = [&](const Node& node) {
    return std::span(below_).subspan(usize(node.first), usize(node.count));
  };
  auto next = static_cast<std::int32_t>(order_.size());  // blocks of the diagonal come first
  filled_ = next;
  for (const Node& node : order_) {
    const auto list = belows(node);
    std::sort(list.begin(), list.end(),
              [&](const Below& x, const Below& y) { return sooner(x, y.id); });
    for (Below& below : list) below.block = next++;
    if (&node - order_.data() + 1 == units_) filled_ = next;
  }
  blocks_.reset(usize(next));
  std::memset(blocks_.data(), 0, blocks_.size() * sizeof(Block));
  // The block of two nodes.
  const auto block_of = [&](std::int32_t early, std::int32_t late) {
    const auto list = belows(order_[usize(position[usize(early)])]);
    return std::lower_bound(list.begin(), list.end(), late, sooner)->block;
  };
  update_.clear();
  for (const Node& node : order_) {
    const auto list = belows(node);
    for (std::size_t j = 0; j < list.size(); ++j) {
      update_.push_back(list[j].id);
      for (std::size_t i = j + 1; i < list.size(); ++i)
        update_.push_back(block_of(list[j].id, list[i].id));
    }
  }
  const auto side = [&](std::int32_t body, std::int32_t id) -> Side {
    if (body < 0) return {-1, false};
    const bool transposed = position[usize(id)] < position[usize(body)];
    return {transposed ? block_of(id, body) : block_of(body, id), transposed};
  };
  side_a_.clear(), side_b_.clear();
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const auto id = static_cast<std::int32_t>(usize(bodies_) + j);
    side_a_.push_back(side(joints[j].a, id));
    side_b_.push_back(side(joints[j].b, id));
  }
  std::int32_t most = 0;
  for (const Node& node : order_) most = std::max(most, node.count);
  before_.reset(usize(most));
  x_.reset(order_.size());
}

void JointMatrix::clear() {
  std::memset(&blocks_[usize(filled_)], 0, (blocks_.size() - usize(filled_)) * sizeof(Block));
  for (const Node& node : others()) {
    Block& D = blocks_[usize(node.id)] = {};
    for (int k = 0; k < node.size; ++k) D.entry[k * kColumn + k] = node.id < bodies_ ? 1 : -1;
  }
}

void JointMatrix::put(const Side& side, int row, const Piece& gradient) {
  if (side.block < 0) return;
  double* const block = blocks_[usize(side.block)].entry;
  for (int k = 0; k < kSize; ++k)
    block[side.transposed ? row * kColumn + k : k * kColumn + row] = gradient[usize(k)];
}

void JointMatrix::set(std::int32_t joint, int row, const Piece& gradient_a, const Piece& gradient_b,
                      double E) {
  put(side_a_[usize(joint)], row, gradient_a);
  put(side_b_[usize(joint)], row, gradient_b);
  blocks_[usize(bodies_ + joint)].entry[row * kColumn + row] = -E;
}

// Below a node L = B D^-1, and what it leaves is A - L B^T.
void JointMatrix::factor() {
  const std::int32_t* target = update_.data();
  for (const Node& node : units()) {
    const Below* const below = below_.data() + node.first;
    for (int j = 0; j < node.count; ++j)
      for (int i = j; i < node.count; ++i, ++target)
        subtract<kSize>(blocks_[usize(below[i].block)].entry, blocks_[usize(below[j].block)].entry,
                        size_[usize(below[j].id)], blocks_[usize(*target)].entry);
  }
  for (const Node& node : others()) {
    double* const D = blocks_[usize(node.id)].entry;
    const Below* const below = below_.data() + node.first;
    with_size(node.size, [&](auto size) {
      constexpr int kN = decltype(size)::value;
      invert<kN>(D);
      for (int j = 0; j < node.count; ++j) {
        Block& block = blocks_[usize(below[j].block)];
        before_[usize(j)] = block;
        multiply<kN>(before_[usize(j)].entry, D, kN, block.entry);
      }
      for (int j = 0; j < node.count; ++j) {
        const int columns = size_[usize(below[j].id)];
        for (int i = j; i < node.count; ++i, ++target)
          subtract<kN>(blocks_[usize(below[i].block)].entry, before_[usize(j)].entry, columns,
                       blocks_[usize(*target)].entry);
      }
    });
  }
}

void JointMatrix::solve(std::span<Piece> joints) {
  std::memset(x_.data(), 0, usize(bodies_) * sizeof(Column));
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const double* const c = joints[j].data();
    Pair x;
    x.add(-1, Pair(c));
    x.store(x_[usize(bodies_) + j].entry);
  }
  for (const Node& node : others()) {  // L y = b
    const double* const x = x_[usize(node.id)].entry;
    with_size(node.size, [&](auto size) {
      for (std::int32_t j = node.first; j < node.first + node.count; ++j) {
        double* const later = x_[usize(below_[usize(j)].id)].entry;
        Pair left(later);
        add_product<decltype(size)::value>(-1, blocks_[usize(below_[usize(j)].block)].entry, x,
                                           left);
        left.store(later);
      }
    });
  }
  const auto nodes = others();
  for (auto node = nodes.rbegin(); node != nodes.rend(); ++node) {  // L^T x = D^-1 y
    double* const x = x_[usize(node->id)].entry;
    Pair sum;
    with_size(node->size, [&](auto size) {
      add_product<decltype(size)::value>(1, blocks_[usize(node->id)].entry, x, sum);
    });
    for (std::int32_t j = node->first; j < node->first + node->count; ++j) {
      const Pair later(x_[usize(below_[usize(j)].id)].entry);
      const Pair part = transposed_product(blocks_[usize(below_[usize(j)].block)].entry, later);
      sum.top = sum.top - part.top, sum.bottom = sum.bottom - part.bottom;
    }
    sum.store(x);
  }
  for (std::size_t j = 0; j < joints.size(); ++j) {
    for (std::size_t k = 0; k < kSize; ++k) {
      const bool used = k < usize(size_[usize(bodies_) + j]);
      joints[j][k] = used ? -x_[usize(bodies_) + j].entry[k] : 0;
    }
  }
}

}  // namespace substep::rigid
