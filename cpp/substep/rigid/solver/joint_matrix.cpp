#include "substep/rigid/solver/joint_matrix.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

constexpr int kSize = JointMatrix::kSize;

// C of D = s C C^T in the lower triangle of D, with the inverse of its diagonal.
void cholesky(double* D, int n, double s) {
  for (int j = 0; j < n; ++j) {
    double sum = s * D[j * kSize + j];
    for (int k = 0; k < j; ++k) sum -= D[j * kSize + k] * D[j * kSize + k];
    const double inverse = 1 / std::sqrt(sum);
    D[j * kSize + j] = inverse;
    for (int i = j + 1; i < n; ++i) {
      double entry = s * D[i * kSize + j];
      for (int k = 0; k < j; ++k) entry -= D[i * kSize + k] * D[j * kSize + k];
      D[i * kSize + j] = entry * inverse;
    }
  }
}

// x s C^T = b, row after row of b.
void solve_rows(const double* C, int n, double s, double* b, int rows) {
  for (int i = 0; i < rows; ++i) {
    double* x = b + i * kSize;
    for (int j = 0; j < n; ++j) {
      double sum = s * x[j];
      for (int k = 0; k < j; ++k) sum -= x[k] * C[j * kSize + k];
      x[j] = sum * C[j * kSize + j];
    }
  }
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
    size_[usize(id)] = rows[j];
    for (const std::int32_t body : {joints[j].a, joints[j].b}) {
      if (body < 0) continue;
      near[usize(id)].push_back(body);
      near[usize(body)].push_back(id);
      ++waits[usize(id)];
    }
  }
  for (auto& list : near) std::sort(list.begin(), list.end());
  const auto joints_of = near;
  std::vector<std::uint8_t> done(nodes, 0);

  std::set<std::pair<std::size_t, std::int32_t>> queue;  // degree, node
  const auto enter = [&](std::int32_t id) {
    if (waits[usize(id)] == 0) queue.emplace(near[usize(id)].size(), id);
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
      const auto& own = joints_of[usize(id)];
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
      queue.erase({list.size(), other});
      merged.clear();
      std::set_union(list.begin(), list.end(), later.begin(), later.end(),
                     std::back_inserter(merged));
      std::erase_if(merged, [&](std::int32_t k) { return k == id || k == other; });
      list = merged;
      enter(other);
    }
  }
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
  for (const Node& node : order_) {
    const auto list = belows(node);
    std::sort(list.begin(), list.end(),
              [&](const Below& x, const Below& y) { return sooner(x, y.id); });
    for (Below& below : list) below.block = next++;
  }
  blocks_.resize(usize(next));
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
  x_.resize(order_.size());
}

void JointMatrix::clear() {
  for (Block& block : blocks_) block.fill(0);
  for (std::size_t id = 0; id < size_.size(); ++id) {
    const double sign = id < usize(bodies_) ? 1 : -1;
    for (int k = 0; k < size_[id]; ++k) blocks_[id][usize(k * kSize + k)] = sign;
  }
}

void JointMatrix::put(const Side& side, int row, const Piece& gradient) {
  if (side.block < 0) return;
  Block& block = blocks_[usize(side.block)];
  for (int k = 0; k < kSize; ++k)
    block[usize(side.transposed ? k * kSize + row : row * kSize + k)] = gradient[usize(k)];
}

void JointMatrix::set(std::int32_t joint, int row, const Piece& gradient_a, const Piece& gradient_b,
                      double E) {
  put(side_a_[usize(joint)], row, gradient_a);
  put(side_b_[usize(joint)], row, gradient_b);
  blocks_[usize(bodies_ + joint)][usize(row * kSize + row)] = -E;
}

void JointMatrix::factor() {
  const std::int32_t* target = update_.data();
  for (const Node& node : order_) {
    const double sign = node.id < bodies_ ? 1 : -1;
    const double* C = blocks_[usize(node.id)].data();
    cholesky(blocks_[usize(node.id)].data(), node.size, sign);
    const Below* below = below_.data() + node.first;
    for (int j = 0; j < node.count; ++j) {
      solve_rows(C, node.size, sign, blocks_[usize(below[j].block)].data(),
                 size_[usize(below[j].id)]);
    }
    for (int j = 0; j < node.count; ++j) {
      const double* Y = blocks_[usize(below[j].block)].data();
      const int columns = size_[usize(below[j].id)];
      for (int i = j; i < node.count; ++i, ++target) {
        const double* X = blocks_[usize(below[i].block)].data();
        double* A = blocks_[usize(*target)].data();
        for (int r = 0; r < size_[usize(below[i].id)]; ++r) {
          for (int c = 0; c < (i == j ? r + 1 : columns); ++c) {
            double sum = 0;
            for (int k = 0; k < node.size; ++k) sum += X[r * kSize + k] * Y[c * kSize + k];
            A[r * kSize + c] -= sign * sum;
          }
        }
      }
    }
  }
}

void JointMatrix::solve(std::span<Piece> joints) {
  for (std::size_t id = 0; id < x_.size(); ++id) {
    if (id < usize(bodies_)) {
      x_[id].fill(0);
    } else {
      for (std::size_t k = 0; k < kSize; ++k) x_[id][k] = -joints[id - usize(bodies_)][k];
    }
  }
  for (const Node& node : order_) {  // L y = b
    Piece& x = x_[usize(node.id)];
    solve_rows(blocks_[usize(node.id)].data(), node.size, 1, x.data(), 1);
    for (std::int32_t j = node.first; j < node.first + node.count; ++j) {
      const double* Y = blocks_[usize(below_[usize(j)].block)].data();
      Piece& later = x_[usize(below_[usize(j)].id)];
      for (int r = 0; r < size_[usize(below_[usize(j)].id)]; ++r) {
        for (int k = 0; k < node.size; ++k) later[usize(r)] -= Y[r * kSize + k] * x[usize(k)];
      }
    }
  }
  for (auto node = order_.rbegin(); node != order_.rend(); ++node) {  // L^T x = S y
    Piece& x = x_[usize(node->id)];
    if (node->id >= bodies_) {
      for (double& entry : x) entry = -entry;
    }
    for (std::int32_t j = node->first; j < node->first + node->count; ++j) {
      const double* Y = blocks_[usize(below_[usize(j)].block)].data();
      const Piece& later = x_[usize(below_[usize(j)].id)];
      for (int r = 0; r < size_[usize(below_[usize(j)].id)]; ++r) {
        for (int k = 0; k < node->size; ++k) x[usize(k)] -= Y[r * kSize + k] * later[usize(r)];
      }
    }
    const double* C = blocks_[usize(node->id)].data();
    for (int k = node->size - 1; k >= 0; --k) {
      double sum = x[usize(k)];
      for (int i = k + 1; i < node->size; ++i) sum -= C[i * kSize + k] * x[usize(i)];
      x[usize(k)] = sum * C[k * kSize + k];
    }
  }
  for (std::size_t j = 0; j < joints.size(); ++j) {
    for (std::size_t k = 0; k < kSize; ++k) {
      const bool used = k < usize(size_[usize(bodies_) + j]);
      joints[j][k] = used ? -x_[usize(bodies_) + j][k] : 0;
    }
  }
}

}  // namespace substep::rigid
