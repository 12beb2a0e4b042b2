#include "substep/rigid/solver/joint_matrix.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

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
  const std::size_t nodes = at(bodies) + joints.size();
  size_.assign(nodes, kSize);
  std::vector<std::vector<std::int32_t>> near(nodes);
  std::vector<int> waits(nodes, 0);  // a joint, for so many bodies
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const auto id = static_cast<std::int32_t>(at(bodies) + j);
    size_[at(id)] = rows[j];
    for (const std::int32_t body : {joints[j].a, joints[j].b}) {
      if (body < 0) continue;
      near[at(id)].push_back(body);
      near[at(body)].push_back(id);
      ++waits[at(id)];
    }
  }
  for (auto& list : near) std::sort(list.begin(), list.end());
  const auto joints_of = near;
  std::vector<std::uint8_t> done(nodes, 0);

  std::set<std::pair<std::size_t, std::int32_t>> queue;  // degree, node
  const auto enter = [&](std::int32_t id) {
    if (waits[at(id)] == 0) queue.emplace(near[at(id)].size(), id);
  };
  for (std::size_t id = 0; id < nodes; ++id) enter(static_cast<std::int32_t>(id));
  order_.clear();
  below_.clear();
  std::vector<std::int32_t> merged;
  while (!queue.empty()) {
    const std::int32_t id = queue.begin()->second;
    queue.erase(queue.begin());
    done[at(id)] = 1;
    const auto later = std::move(near[at(id)]);
    if (id < bodies) {
      const auto& own = joints_of[at(id)];
      const auto left =
          std::count_if(own.begin(), own.end(), [&](std::int32_t j) { return done[at(j)] == 0; });
      for (const std::int32_t j : own) waits[at(j)] = left == 1 ? 0 : std::max(waits[at(j)] - 1, 0);
    }
    order_.push_back({id, size_[at(id)], static_cast<std::int32_t>(below_.size()),
                      static_cast<std::int32_t>(later.size())});
    for (const std::int32_t other : later) {
      below_.push_back({other, -1});
      auto& list = near[at(other)];
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
    position[at(order_[k].id)] = static_cast<std::int32_t>(k);
  const auto sooner = [&](const Below& x, std::int32_t id) {
    return position[at(x.id)] < position[at(id)];
  };
  const auto belows = [&](const Node& node) {
    return std::span(below_).subspan(at(node.first), at(node.count));
  };
  auto next = static_cast<std::int32_t>(order_.size());  // blocks of the diagonal come first
  for (const Node& node : order_) {
    const auto list = belows(node);
    std::sort(list.begin(), list.end(),
              [&](const Below& x, const Below& y) { return sooner(x, y.id); });
    for (Below& below : list) below.block = next++;
  }
  blocks_.resize(at(next));
  // The block of two nodes.
  const auto block_of = [&](std::int32_t early, std::int32_t late) {
    const auto list = belows(order_[at(position[at(early)])]);
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
    const bool transposed = position[at(id)] < position[at(body)];
    return {transposed ? block_of(id, body) : block_of(body, id), transposed};
  };
  side_a_.clear(), side_b_.clear();
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const auto id = static_cast<std::int32_t>(at(bodies_) + j);
    side_a_.push_back(side(joints[j].a, id));
    side_b_.push_back(side(joints[j].b, id));
  }
  x_.resize(order_.size());
}

void JointMatrix::clear() {
  for (Block& block : blocks_) block.fill(0);
  for (std::size_t id = 0; id < size_.size(); ++id) {
    const double sign = id < at(bodies_) ? 1 : -1;
    for (int k = 0; k < size_[id]; ++k) blocks_[id][at(k * kSize + k)] = sign;
  }
}

void JointMatrix::put(const Side& side, int row, const Piece& gradient) {
  if (side.block < 0) return;
  Block& block = blocks_[at(side.block)];
  for (int k = 0; k < kSize; ++k)
    block[at(side.transposed ? k * kSize + row : row * kSize + k)] = gradient[at(k)];
}

void JointMatrix::set(std::int32_t joint, int row, const Piece& gradient_a, const Piece& gradient_b,
                      double E) {
  put(side_a_[at(joint)], row, gradient_a);
  put(side_b_[at(joint)], row, gradient_b);
  blocks_[at(bodies_ + joint)][at(row * kSize + row)] = -E;
}

void JointMatrix::factor() {
  const std::int32_t* target = update_.data();
  for (const Node& node : order_) {
    const double sign = node.id < bodies_ ? 1 : -1;
    const double* C = blocks_[at(node.id)].data();
    cholesky(blocks_[at(node.id)].data(), node.size, sign);
    const Below* below = below_.data() + node.first;
    for (int j = 0; j < node.count; ++j) {
      solve_rows(C, node.size, sign, blocks_[at(below[j].block)].data(), size_[at(below[j].id)]);
    }
    for (int j = 0; j < node.count; ++j) {
      const double* Y = blocks_[at(below[j].block)].data();
      const int columns = size_[at(below[j].id)];
      for (int i = j; i < node.count; ++i, ++target) {
        const double* X = blocks_[at(below[i].block)].data();
        double* A = blocks_[at(*target)].data();
        for (int r = 0; r < size_[at(below[i].id)]; ++r) {
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
    if (id < at(bodies_)) {
      x_[id].fill(0);
    } else {
      for (std::size_t k = 0; k < kSize; ++k) x_[id][k] = -joints[id - at(bodies_)][k];
    }
  }
  for (const Node& node : order_) {  // L y = b
    Piece& x = x_[at(node.id)];
    solve_rows(blocks_[at(node.id)].data(), node.size, 1, x.data(), 1);
    for (std::int32_t j = node.first; j < node.first + node.count; ++j) {
      const double* Y = blocks_[at(below_[at(j)].block)].data();
      Piece& later = x_[at(below_[at(j)].id)];
      for (int r = 0; r < size_[at(below_[at(j)].id)]; ++r) {
        for (int k = 0; k < node.size; ++k) later[at(r)] -= Y[r * kSize + k] * x[at(k)];
      }
    }
  }
  for (auto node = order_.rbegin(); node != order_.rend(); ++node) {  // L^T x = S y
    Piece& x = x_[at(node->id)];
    if (node->id >= bodies_) {
      for (double& entry : x) entry = -entry;
    }
    for (std::int32_t j = node->first; j < node->first + node->count; ++j) {
      const double* Y = blocks_[at(below_[at(j)].block)].data();
      const Piece& later = x_[at(below_[at(j)].id)];
      for (int r = 0; r < size_[at(below_[at(j)].id)]; ++r) {
        for (int k = 0; k < node->size; ++k) x[at(k)] -= Y[r * kSize + k] * later[at(r)];
      }
    }
    const double* C = blocks_[at(node->id)].data();
    for (int k = node->size - 1; k >= 0; --k) {
      double sum = x[at(k)];
      for (int i = k + 1; i < node->size; ++i) sum -= C[i * kSize + k] * x[at(i)];
      x[at(k)] = sum * C[k * kSize + k];
    }
  }
  for (std::size_t j = 0; j < joints.size(); ++j) {
    for (std::size_t k = 0; k < kSize; ++k) {
      const bool used = k < at(size_[at(bodies_) + j]);
      joints[j][k] = used ? -x_[at(bodies_) + j][k] : 0;
    }
  }
}

}  // namespace substep::rigid
