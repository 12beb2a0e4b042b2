#include "substep/gridfluid/pressure/transform_solver.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/aligned_buffer.h"
#include "substep/core/parallel.h"
#include "substep/gridfluid/pressure/packet.h"
#include "substep/gridfluid/pressure/row_product.h"

namespace substep::gridfluid {
namespace {

// Coefficients, which stand where they are, as the numbers of a LineTransform do not.
struct InOrder {
  int size() const { return n; }
  static int place(int k) { return k; }
  static double factor(int) { return 1; }
  int n;
};

// Lane l of v[i] becomes lane i of v[l], by zipping the first half with the second again and again.
SUBSTEP_INLINE void transpose(Packet* v) {
  const auto zip = [&]<int... kLane>(std::integer_sequence<int, kLane...>) {
    Packet zipped[kPacket];
    for (int i = 0; i < kPacket / 2; ++i) {
      const Packet &a = v[i], &b = v[i + kPacket / 2];
      zipped[2 * i] = __builtin_shufflevector(a, b, (kLane / 2 + kLane % 2 * kPacket)...);
      zipped[2 * i + 1] =
          __builtin_shufflevector(a, b, (kLane / 2 + kLane % 2 * kPacket + kPacket / 2)...);
    }
    std::copy_n(zipped, kPacket, v);
  };
  for (int size = 1; size < kPacket; size *= 2) zip(std::make_integer_sequence<int, kPacket>());
}

// The first `count` numbers of v, or all.
SUBSTEP_INLINE void put_some(const Packet& v, double* to, int count) {
  if (count >= kPacket) {
    store<kPacket>(v, to);
  } else if (count > 0) {
    std::memcpy(to, &v, usize(count) * sizeof(double));
  }
}

// z from `lines` lines, whose numbers are one after the other, or to them.
template <class From, class Order>
void load_rows(const Order& order, const From* from, std::int64_t stride, int lines, double* z) {
  for (int half = 0; half < kLines; half += kPacket) {
    for (int i = 0; i < order.size(); i += kPacket) {  // and what is beyond the end of the row
      Packet v[kPacket];
      for (int l = 0; l < kPacket; ++l) {
        v[l] = doubles<kPacket>(from + std::min(half + l, lines - 1) * stride + i);
      }
      transpose(v);
      for (int c = 0; c < std::min(kPacket, order.size() - i); ++c) {
        store<kPacket>(order.factor(i + c) * v[c], z + order.place(i + c) * kLines + half);
      }
    }
  }
}
template <class Order>
void store_rows(const Order& order, const double* z, double* to, std::int64_t stride, int lines) {
  for (int half = 0; half < lines; half += kPacket) {
    for (int i = 0; i < order.size(); i += kPacket) {
      const int count = std::min(kPacket, order.size() - i);
      Packet v[kPacket]{};
      for (int c = 0; c < count; ++c) {
        v[c] = order.factor(i + c) * load<Packet>(z + order.place(i + c) * kLines + half);
      }
      transpose(v);
      for (int l = 0; l < std::min(kPacket, lines - half); ++l) {
        put_some(v[l], to + (half + l) * stride + i, count);
      }
    }
  }
}

// The same of lines beside each other, whose numbers are `stride` apart.
template <class Order>
void load_columns(const Order& order, const double* from, std::int64_t stride, double* z) {
  for (int i = 0; i < order.size(); ++i) {
    const double* const at = from + i * stride;
    double* const to = z + order.place(i) * kLines;
    store<kPacket>(order.factor(i) * load<Packet>(at), to);
    store<kPacket>(order.factor(i) * load<Packet>(at + kPacket), to + kPacket);
  }
}
template <class Order>
void store_columns(const Order& order, const double* z, double* to, std::int64_t stride,
                   int lines) {
  for (int i = 0; i < order.size(); ++i) {
    const double* const at = z + order.place(i) * kLines;
    const Packet low = order.factor(i) * load<Packet>(at);
    const Packet high = order.factor(i) * load<Packet>(at + kPacket);
    double* const there = to + i * stride;
    put_some(low, there, lines), put_some(high, there + kPacket, lines - kPacket);
  }
}

LineEnds ends(bool periodic, const std::array<bool, 2>& open) {
  if (periodic) return LineEnds::kPeriodic;
  if (open[0]) return open[1] ? LineEnds::kOpen : LineEnds::kOpenWall;
  return open[1] ? LineEnds::kWallOpen : LineEnds::kWalls;
}

std::array<double, 2> in_order(const std::vector<std::array<double, 2>>& parts) {
  std::array<double, 2> sums{};
  for (const std::array<double, 2>& part : parts) sums[0] += part[0], sums[1] += part[1];
  return sums;
}

AlignedBuffer<double> scratch(std::size_t n) {
  AlignedBuffer<double> z;
  z.reset(n);
  return z;
}

}  // namespace

template <class Real, int D>
bool TransformSolver<Real, D>::can(const Layout<D>& layout) {
  return std::all_of(layout.cells.begin(), layout.cells.end(), LineTransform::can);
}

template <class Real, int D>
TransformSolver<Real, D>::TransformSolver(const Layout<D>& layout, const OpenSides<D>& open)
    : layout_(layout) {
  for (std::size_t a = 0; a < D; ++a) {
    along_.emplace_back(layout.cells[a], ends(layout.periodic[a], open[a]));
    closed_ = closed_ && along_[a].eigenvalue(0) == 0;
    room_ = std::max(room_, usize(layout.cells[a] * kLines));
  }
  const int n = layout.row_length();
  for (int k = 0; k < n; ++k) eigenvalues_.push_back(along_[D - 1].eigenvalue(k));
  eigenvalues_.resize(usize(n + kLines), 1.0);
}

// Planes in three dimensions; in two, rows that are transformed at once.
template <class Real, int D>
std::int64_t TransformSolver<Real, D>::slabs() const {
  return D == 3 ? layout_.cells[0] : (layout_.cells[0] + kLines - 1) / kLines;
}

// use(first, rows) of rows of a slab that are transformed at once.
template <class Real, int D>
template <class Use>
void TransformSolver<Real, D>::for_row_groups(std::int64_t slab, const Use& use) const {
  const int rows = layout_.cells[D - 2], begin = D == 2 ? static_cast<int>(slab) * kLines : 0;
  const std::int64_t first = layout_.first + (D == 3 ? slab * layout_.stride[0] : 0);
  for (int r = begin; r < (D == 2 ? begin + 1 : rows); r += kLines) {
    use(first + r * layout_.stride[D - 2], std::min(kLines, rows - r));
  }
}

// To coefficients along the first axis there, which eigenvalues divide, and back.
template <class Real, int D>
void TransformSolver<Real, D>::divide(double* p, std::int64_t row, int column, double* z) const {
  const LineTransform& line = along_[0];
  double* const at = p + layout_.first + (D == 3 ? row * layout_.stride[1] : 0) + column;
  load_columns(line, at, layout_.stride[0], z);
  line.forward(z);
  double others = 0, scale = 1;
  if constexpr (D == 3) others = along_[1].eigenvalue(static_cast<int>(row));
  for (const LineTransform& each : along_) scale *= each.scale();
  for (int half = 0; half < kLines; half += kPacket) {
    const Packet sum = others + load<Packet>(eigenvalues_.data() + column + half);
    for (int k = 0; k < line.size(); ++k) {
      double* const x = z + k * kLines + half;
      store<kPacket>(scale * load<Packet>(x) / (sum + line.eigenvalue(k)), x);
    }
  }
  if (closed_ && row == 0 && column == 0) z[0] = 0;  // the mean
  line.backward(z);
  store_columns(line, z, at, layout_.stride[0], layout_.row_length() - column);
}

template <class Real, int D>
void TransformSolver<Real, D>::divide(double* p, int threads) const {
  const std::int64_t rows = D == 3 ? layout_.cells[1] : 1;
  const std::int64_t groups = (layout_.row_length() + kLines - 1) / kLines;
  parallel_for(
      rows * groups, D == 3 ? groups : 1,
      [&](std::int64_t begin, std::int64_t end) {
        AlignedBuffer<double> z = scratch(room_);
        for (std::int64_t i = begin; i < end; ++i) {
          divide(p, i / groups, static_cast<int>(i % groups) * kLines, z.data());
        }
      },
      threads);
}

// use(line, p of its first numbers, number of lines) of lines of a slab along the middle axis.
template <class Real, int D>
template <class Use>
void TransformSolver<Real, D>::for_middle(std::int64_t slab, double* p, const Use& use) const {
  if constexpr (D == 3) {
    const int n = layout_.row_length();
    for (int column = 0; column < n; column += kLines) {
      use(along_[1], p + layout_.first + slab * layout_.stride[0] + column,
          std::min(kLines, n - column));
    }
  }
}

// p becomes coefficients along all axes but the first. The sums of b and of |b|.
template <class Real, int D>
auto TransformSolver<Real, D>::transform(std::span<const Real> b, double* p, int threads) const
    -> Sums {
  const LineTransform& last = along_[D - 1];
  const std::int64_t stride = layout_.stride[D - 2];
  const int n = last.size();
  std::vector<Sums> parts(usize(slabs()));
  parallel_for(
      slabs(), 1,
      [&](std::int64_t slab, std::int64_t) {
        AlignedBuffer<double> z = scratch(room_);
        for_row_groups(slab, [&](std::int64_t first, int rows) {
          for (int r = 0; r < rows; ++r) {
            const Real* const row = b.data() + first + r * stride;
            auto& [sum, absolute] = parts[usize(slab)];
            sum += sum_over(n, [&]<int kCount>(int i) { return doubles<kCount>(row + i); });
            absolute += sum_over(n, [&]<int kCount>(int i) {
              const auto v = doubles<kCount>(row + i);
              return v < 0 ? -v : v;
            });
          }
          load_rows(last, b.data() + first, stride, rows, z.data());
          last.forward(z.data());
          store_rows(InOrder{n}, z.data(), p + first, stride, rows);
        });
        for_middle(slab, p, [&](const LineTransform& middle, double* at, int lines) {
          load_columns(middle, at, stride, z.data());
          middle.forward(z.data());
          store_columns(InOrder{middle.size()}, z.data(), at, stride, lines);
        });
      },
      threads);
  return in_order(parts);
}

template <class Real, int D>
void TransformSolver<Real, D>::transform_back(double* p, int threads) const {
  const LineTransform& last = along_[D - 1];
  const std::int64_t stride = layout_.stride[D - 2];
  parallel_for(
      slabs(), 1,
      [&](std::int64_t slab, std::int64_t) {
        AlignedBuffer<double> z = scratch(room_);
        for_middle(slab, p, [&](const LineTransform& middle, double* at, int lines) {
          load_columns(InOrder{middle.size()}, at, stride, z.data());
          middle.backward(z.data());
          store_columns(middle, z.data(), at, stride, lines);
        });
        for_row_groups(slab, [&](std::int64_t first, int rows) {
          load_rows(InOrder{last.size()}, p + first, stride, rows, z.data());
          last.backward(z.data());
          store_rows(last, z.data(), p + first, stride, rows);
        });
      },
      threads);
}

// |b - mean - A p|^2 and |b - mean|^2.
template <class Real, int D>
auto TransformSolver<Real, D>::residual(const Coefficients& w, std::span<const Real> b, double mean,
                                        double* p, int threads) const -> Sums {
  std::vector<Sums> parts(usize(layout_.cells[0]));
  const FluidRows<D> all(layout_);
  for_slabs(
      all,
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k) {
          for_rows(all, k, [&](const Row<D>& row) {
            wrap_row(layout_, row, p);
            const Real* const right = b.data() + row.at;
            const auto add_squares = [&](double& sum, const auto& term) {
              sum += sum_over(row.length, [&]<int kCount>(int i) {
                const auto v = term.template operator()<kCount>(i);
                return decltype(v * v)(v * v);
              });
            };
            auto& [rr, bb] = parts[usize(k)];
            add_squares(rr, [&]<int kCount>(int i) {
              return doubles<kCount>(right + i) - mean - product<kCount, D>(w, row, p, i);
            });
            add_squares(bb, [&]<int kCount>(int i) { return doubles<kCount>(right + i) - mean; });
          });
        }
      },
      threads);
  return in_order(parts);
}

template <class Real, int D>
SolveReport TransformSolver<Real, D>::solve(const Coefficients& w, std::span<const Real> b,
                                            std::span<double> p, int threads) const {
  const auto [sum, absolute] = transform(b, p.data(), threads);
  divide(p.data(), threads);
  transform_back(p.data(), threads);
  const double mean = closed_ ? sum / static_cast<double>(layout_.count()) : 0;
  const auto [rr, bb] = residual(w, b, mean, p.data(), threads);
  SolveReport report;
  report.direct = true;
  report.iterations = 1;
  report.residual = std::sqrt(bb > 0 ? rr / bb : rr);
  report.converged = std::isfinite(report.residual);
  report.closed_regions = closed_;
  report.imbalance = closed_ && absolute > 0 ? std::abs(sum) / absolute : 0;
  return report;
}

template class TransformSolver<float, 2>;
template class TransformSolver<float, 3>;
template class TransformSolver<double, 2>;
template class TransformSolver<double, 3>;

}  // namespace substep::gridfluid
