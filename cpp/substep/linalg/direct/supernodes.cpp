#include "substep/linalg/direct/supernodes.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "substep/core/usize.h"
#include "substep/linalg/direct/ordering.h"

namespace substep {
namespace {

using Graph = std::vector<std::vector<std::int32_t>>;

// Rows below the diagonal of each column of the factor: those of the matrix and of its children.
Graph factor_columns(const Graph& upper, std::vector<std::int32_t>& parent) {
  const std::size_t n = upper.size();
  Graph columns = upper;
  std::vector<std::vector<std::int32_t>> children(n);
  parent.assign(n, -1);
  std::vector<std::int32_t> merged;
  for (std::size_t j = 0; j < n; ++j) {
    auto& column = columns[j];
    for (const std::int32_t child : children[j]) {
      merged.clear();
      std::set_union(column.begin(), column.end(), columns[child].begin() + 1, columns[child].end(),
                     std::back_inserter(merged));
      column.swap(merged);
    }
    if (column.empty()) continue;
    parent[j] = column.front();
    children[column.front()].push_back(static_cast<std::int32_t>(j));
  }
  return columns;
}

struct Node {
  std::int32_t first, last;        // columns [first, last)
  std::vector<std::int32_t> rows;  // below them
  double zeros = 0.0;              // entries of the factor that merging made
  std::int32_t width() const { return last - first; }
};

double entries(double columns, double rows) { return columns * (columns + 1) / 2 + columns * rows; }

// Whether the zeros of a merged supernode are worth it: limits as CHOLMOD's nrelax and zrelax.
bool worth_merging(double width, double zeros, double total) {
  if (width <= 4) return true;
  const double share = zeros / total;
  return width <= 16 ? share < 0.8 : width <= 48 ? share < 0.1 : share < 0.05;
}

// The graph of the vertices in a given order: for each vertex those after it, sorted.
Graph later_neighbours(const SparsePattern& lower, std::int32_t block,
                       const std::vector<std::int32_t>& places) {
  Graph graph(places.size());
  for (std::int32_t c = 0; c < lower.cols; c += block) {  // the first row stands for its vertex
    for (std::int32_t k = lower.start[c]; k < lower.start[c + block]; ++k) {
      const std::int32_t a = places[c / block], b = places[lower.row[k] / block];
      if (a != b) graph[std::min(a, b)].push_back(std::max(a, b));
    }
  }
  for (auto& later : graph) {
    std::sort(later.begin(), later.end());
    later.erase(std::unique(later.begin(), later.end()), later.end());
  }
  return graph;
}

// Elimination tree (Liu, "The role of elimination trees in sparse factorization", SIAM J. Matrix
// Anal. Appl. 11 (1990) 134-172, algorithm 4.2), with compressed paths.
std::vector<std::int32_t> elimination_tree(const Graph& later) {
  const auto n = static_cast<std::int32_t>(later.size());
  Graph earlier(later.size());
  for (std::int32_t i = 0; i < n; ++i) {
    for (const std::int32_t j : later[i]) earlier[j].push_back(i);
  }
  std::vector<std::int32_t> parent(later.size(), -1), ancestor(later.size(), -1);
  for (std::int32_t j = 0; j < n; ++j) {
    for (std::int32_t i : earlier[j]) {
      while (ancestor[i] != -1 && ancestor[i] != j) i = std::exchange(ancestor[i], j);
      if (ancestor[i] == -1) ancestor[i] = parent[i] = j;
    }
  }
  return parent;
}

// Children before their parents, subtrees together.
std::vector<std::int32_t> postorder(const std::vector<std::int32_t>& parent) {
  const auto n = static_cast<std::int32_t>(parent.size());
  Graph children(parent.size() + 1);
  for (std::int32_t j = 0; j < n; ++j) children[parent[j] < 0 ? n : parent[j]].push_back(j);
  std::vector<std::int32_t> order, stack;
  for (auto root = children[n].rbegin(); root != children[n].rend(); ++root) stack.push_back(*root);
  while (!stack.empty()) {  // parents before children, last child first; then reversed
    const std::int32_t j = stack.back();
    stack.pop_back();
    order.push_back(j);
    stack.insert(stack.end(), children[j].begin(), children[j].end());
  }
  std::reverse(order.begin(), order.end());
  return order;
}

}  // namespace

Supernodes find_supernodes(const SparsePattern& lower, std::int32_t block, Ordering ordering) {
  Supernodes out;
  const std::int32_t n = lower.cols / block;
  if (ordering == Ordering::automatic) ordering = n < 5000 ? Ordering::amd : Ordering::metis;
  const std::vector<std::int32_t> unknowns = elimination_order(lower, ordering, block);
  std::vector<std::int32_t> order(usize(n)), places(order.size());
  for (std::int32_t k = 0; k < n; ++k) {
    order[k] = unknowns[k * block] / block;
    places[order[k]] = k;
  }
  for (const std::int32_t k : postorder(elimination_tree(later_neighbours(lower, block, places)))) {
    out.order.push_back(order[k]);
  }
  out.places.resize(order.size());
  for (std::int32_t k = 0; k < n; ++k) out.places[out.order[k]] = k;
  std::vector<std::int32_t> tree;
  Graph columns = factor_columns(later_neighbours(lower, block, out.places), tree);
  // Fundamental supernodes, then merging of a node into the one right behind it (its parent).
  std::vector<Node> nodes;
  for (std::int32_t j = 0; j < n; ++j) {
    if (!nodes.empty() && tree[j - 1] == j && columns[j - 1].size() == columns[j].size() + 1) {
      nodes.back().last = j + 1;
      nodes.back().rows = std::move(columns[j]);
    } else {
      nodes.push_back({j, j + 1, std::move(columns[j])});
    }
  }
  // A stack of finished nodes: each new one swallows its last child while that is worth it.
  std::vector<Node> merged;
  for (auto& node : nodes) {
    while (!merged.empty() && !merged.back().rows.empty() &&
           merged.back().rows.front() >= node.first && merged.back().rows.front() < node.last &&
           merged.back().last == node.first) {
      const Node& child = merged.back();
      const double width = child.width() + node.width();
      const double total = entries(width, static_cast<double>(node.rows.size()));
      const double kept = entries(child.width(), static_cast<double>(child.rows.size())) +
                          entries(node.width(), static_cast<double>(node.rows.size()));
      const double zeros = total - kept + child.zeros + node.zeros;
      if (!worth_merging(width * block, zeros, total)) break;
      node.first = child.first;
      node.zeros = zeros;
      merged.pop_back();
    }
    merged.push_back(std::move(node));
  }
  std::vector<std::int32_t> node_of(usize(n));
  for (std::size_t s = 0; s < merged.size(); ++s) {
    for (std::int32_t j = merged[s].first; j < merged[s].last; ++j) {
      node_of[j] = static_cast<std::int32_t>(s);
    }
  }
  out.row_starts.push_back(0);
  for (const Node& node : merged) {
    out.first.push_back(node.first);
    out.parent.push_back(node.rows.empty() ? -1 : node_of[node.rows.front()]);
    out.rows.insert(out.rows.end(), node.rows.begin(), node.rows.end());
    out.row_starts.push_back(static_cast<std::int64_t>(out.rows.size()));
  }
  out.first.push_back(n);
  out.relative.resize(out.rows.size());
  for (std::int64_t s = 0; s < out.count(); ++s) {
    const std::int32_t p = out.parent[s];
    if (p < 0) continue;
    std::int64_t k = out.row_starts[p];
    for (std::int64_t r = out.row_starts[s]; r < out.row_starts[s + 1]; ++r) {
      if (out.rows[r] < out.first[p + 1]) {
        out.relative[r] = out.rows[r] - out.first[p];
      } else {
        while (out.rows[k] != out.rows[r]) ++k;
        out.relative[r] = static_cast<std::int32_t>(out.columns(p) + k - out.row_starts[p]);
      }
    }
  }
  return out;
}

}  // namespace substep
