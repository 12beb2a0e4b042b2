#include "substep/gridfluid/pressure/bodies.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <map>
#include <utility>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/pressure/revolution.h"
#include "substep/linalg/sparse.h"

namespace substep::gridfluid {
namespace {

constexpr std::size_t kNoPiece = static_cast<std::size_t>(-1);

}  // namespace

template <class Real, int D>
void Bodies<Real, D>::find(const Obstacles<Real, D>& obstacles, std::span<const Real> inverse,
                           double mass, int threads) {
  mass_ = mass;
  inverse_ = inverse;
  bodies_.clear();
  pieces_.clear();
  std::vector<std::size_t> piece_of(obstacles.colliders.size(), kNoPiece);
  for (const std::vector<std::size_t>& body : responding_bodies(obstacles.colliders)) {
    for (const std::size_t c : body) {
      piece_of[c] = pieces_.size();
      pieces_.push_back({c, bodies_.size(), {}});
    }
    const geometry::Mat6& mobility = obstacles.colliders[body[0]].body.mobility;
    bodies_.push_back({mass * mobility(kMotionPlaces<D>, kMotionPlaces<D>), {}});
  }
  if (!any()) return;
  find_parts(obstacles, piece_of);
  factorize(threads);
}

template <class Real, int D>
void Bodies<Real, D>::find_parts(const Obstacles<Real, D>& obstacles,
                                 const std::vector<std::size_t>& piece_of) {
  struct Place {  // of a part, and the last place of the same cell before it
    std::size_t piece, part;
    std::int32_t before;
  };
  constexpr std::int32_t kNone = -1;
  std::vector<Place> places;
  std::vector<std::int32_t> last(inverse_.size(), kNone);  // of a cell
  const auto add = [&](std::size_t piece, std::int64_t cell, const Motion& motion) {
    if (!(inverse_[usize(cell)] > 0)) return;
    std::vector<Part>& parts = pieces_[piece].parts;
    std::int32_t p = last[usize(cell)];
    while (p != kNone && places[usize(p)].piece != piece) p = places[usize(p)].before;
    if (p != kNone) {
      parts[places[usize(p)].part].motion += motion;
      return;
    }
    places.push_back({piece, parts.size(), last[usize(cell)]});
    last[usize(cell)] = static_cast<std::int32_t>(places.size() - 1);
    parts.push_back({cell, motion});
  };
  std::vector<geometry::Mat3> turns;
  for (const geometry::Collider& collider : obstacles.colliders)
    turns.push_back(turns_of_pressure<D>(collider));
  for (std::size_t a = 0; a < D; ++a) {
    const int axis = static_cast<int>(a);
    for (const auto& [face, c] : obstacles.faces_near(axis)) {
      const Real covered = 1 - obstacles.open(axis)[usize(face)];
      const std::size_t piece = piece_of[c];
      if (covered == 0 || piece == kNoPiece) continue;
      const std::int64_t below = face - obstacles.layout().stride[a];
      if (!(inverse_[usize(below)] > 0 || inverse_[usize(face)] > 0)) continue;
      const geometry::Collider& collider = obstacles.colliders[c];
      const Vec3 arm = obstacles.middle(face, axis) - collider.position();
      const Vec3 e = Vec3::Unit(axis), lever = collider.position() - collider.centre();
      const geometry::Vec6 pushed = geometry::joined(e, turns[c] * arm.cross(e) + lever.cross(e));
      const Motion motion = double(covered) * pushed(kMotionPlaces<D>);
      add(piece, below, motion);
      add(piece, face, -motion);
    }
  }
}

// K = 1 + L^T N L, by blocks of bodies that are in a cell together.
template <class Real, int D>
void Bodies<Real, D>::factorize(int threads) {
  for (Body& body : bodies_) {
    const Mobility even = 0.5 * (body.c + body.c.transpose());
    // With pivots: joints leave less than the full rank.
    const Eigen::LDLT<Mobility> parts(even);
    const Motion roots = parts.vectorD().cwiseMax(0.0).cwiseSqrt();
    const Mobility lower = parts.matrixL();
    body.root = parts.transpositionsP().transpose() * Mobility(lower * roots.asDiagonal());
  }
  struct Share {  // L^T of the motion of a body in a cell
    std::int64_t cell;
    std::size_t body;
    Motion motion;
  };
  std::vector<Share> shares;
  for (const Piece& piece : pieces_)
    for (const Part& part : piece.parts)
      shares.push_back({part.cell, piece.body, bodies_[piece.body].root.transpose() * part.motion});
  std::stable_sort(shares.begin(), shares.end(), [](const Share& a, const Share& b) {
    return std::pair(a.cell, a.body) < std::pair(b.cell, b.body);
  });
  std::map<std::pair<std::size_t, std::size_t>, Mobility> blocks;  // by column and row
  for (std::size_t k = 0; k < bodies_.size(); ++k) blocks[{k, k}] = Mobility::Identity();
  for (std::size_t i = 0; i < shares.size(); ++i) {
    const double inverse = inverse_[usize(shares[i].cell)];
    for (std::size_t j = i; j < shares.size() && shares[j].cell == shares[i].cell; ++j) {
      const auto [block, is_new] =
          blocks.try_emplace({shares[i].body, shares[j].body}, Mobility::Zero());
      const Mobility product = inverse * shares[j].motion * shares[i].motion.transpose();
      block->second += product;
      if (j > i && shares[j].body == shares[i].body) block->second += product.transpose();
    }
  }
  std::vector<std::pair<std::int32_t, std::int32_t>> places;
  for (const auto& [at, block] : blocks)
    places.emplace_back(static_cast<std::int32_t>(at.second), static_cast<std::int32_t>(at.first));
  const auto count = static_cast<std::int32_t>(bodies_.size());
  const SparsePattern pattern = expand_blocks(build_pattern(count, count, places), kMotions, true);
  std::vector<double> values;
  values.reserve(usize(pattern.entries()));
  for (auto column = blocks.begin(); column != blocks.end();) {
    auto end = column;
    while (end != blocks.end() && end->first.first == column->first.first) ++end;
    for (int j = 0; j < kMotions; ++j)
      for (auto block = column; block != end; ++block)
        for (int i = block == column ? j : 0; i < kMotions; ++i)
          values.push_back(block->second(i, j));
    column = end;
  }
  k_ = std::make_unique<SupernodalCholesky<>>(pattern, 3);
  if (k_->factorize(values, threads) >= 0) k_.reset();  // not finite, as the product will show
}

template <class Real, int D>
std::vector<double> Bodies<Real, D>::to_roots(const std::vector<Motion>& x) const {
  std::vector<double> y(x.size() * kMotions);
  for (std::size_t k = 0; k < x.size(); ++k)
    Eigen::Map<Motion>(y.data() + k * kMotions) = bodies_[k].root.transpose() * x[k];
  return y;
}

template <class Real, int D>
auto Bodies<Real, D>::from_roots(const std::vector<double>& y) const -> std::vector<Motion> {
  std::vector<Motion> x(bodies_.size());
  for (std::size_t k = 0; k < x.size(); ++k)
    x[k] = bodies_[k].root * Eigen::Map<const Motion>(y.data() + k * kMotions);
  return x;
}

// G x of each piece, or G D^-1 x.
template <class Real, int D>
template <bool kScaled, class X>
auto Bodies<Real, D>::gather(std::span<const X> x, int threads) const -> std::vector<Motion> {
  std::vector<Motion> sums(pieces_.size());
  for_numbers(
      static_cast<std::int64_t>(pieces_.size()), threads,
      [&](std::size_t p) {
        Motion sum = Motion::Zero();
        for (const Part& part : pieces_[p].parts) {
          const auto value = double(x[usize(part.cell)]);
          sum += (kScaled ? value * double(inverse_[usize(part.cell)]) : value) * part.motion;
        }
        sums[p] = sum;
      },
      1);
  return sums;
}

template <class Real, int D>
template <bool kScaled, class X>
auto Bodies<Real, D>::gather_bodies(std::span<const X> x, int threads) const
    -> std::vector<Motion> {
  std::vector<Motion> sums(bodies_.size(), Motion::Zero());
  const std::vector<Motion> of_piece = gather<kScaled>(x, threads);
  for (std::size_t p = 0; p < pieces_.size(); ++p) sums[pieces_[p].body] += of_piece[p];
  return sums;
}

// y += G^T moved, or D^-1 G^T moved.
template <class Real, int D>
template <bool kScaled>
void Bodies<Real, D>::scatter(const std::vector<Motion>& moved, std::span<Real> y) const {
  for (const Piece& piece : pieces_) {  // one after the other: two may be in one cell
    for (const Part& part : piece.parts) {
      const double sum = part.motion.dot(moved[piece.body]);
      y[usize(part.cell)] += Real(kScaled ? sum * double(inverse_[usize(part.cell)]) : sum);
    }
  }
}

template <class Real, int D>
template <class X>
double Bodies<Real, D>::add_product(Real sign, std::span<const X> x, std::span<Real> y,
                                    int threads) const {
  std::vector<Motion> of_body = gather_bodies<false>(x, threads);
  double product = 0;
  for (std::size_t k = 0; k < bodies_.size(); ++k) {
    const Motion moved = bodies_[k].c * of_body[k];
    product += moved.dot(of_body[k]);
    of_body[k] = double(sign) * moved;
  }
  scatter<false>(of_body, y);
  return product;
}

template <class Real, int D>
std::vector<double> Bodies<Real, D>::take_moved(std::span<Real> r, int threads) const {
  if (!k_) return {};
  std::vector<double> y = to_roots(gather_bodies<true>(std::span<const Real>(r), threads));
  k_->solve(y, threads);
  std::vector<Motion> taken = from_roots(y);
  for (Motion& moved : taken) moved = -moved;
  scatter<false>(taken, r);
  return y;
}

template <class Real, int D>
void Bodies<Real, D>::add_moved(std::vector<double> y, std::span<Real> z, int threads) const {
  if (!k_) return;
  const std::vector<double> of_z =
      to_roots(gather_bodies<false>(std::span<const Real>(z), threads));
  for (std::size_t i = 0; i < y.size(); ++i) y[i] -= of_z[i];
  k_->solve(y, threads);
  scatter<true>(from_roots(y), z);
}

template <class Real, int D>
void Bodies<Real, D>::push(std::span<const double> q, std::vector<geometry::Collider>& colliders,
                           int threads) const {
  const std::vector<Motion> impulses = gather<false>(q, threads);
  for (std::size_t p = 0; p < pieces_.size(); ++p) {
    geometry::Collider& collider = colliders[pieces_[p].collider];
    collider.set_exchange(exchange_of<D>(mass_ * impulses[p], collider));
  }
}

template <class Real, int D>
void Bodies<Real, D>::move(std::vector<geometry::Collider>& colliders) const {
  std::vector<geometry::Vec6> impulses(bodies_.size(), geometry::Vec6::Zero());
  for (const Piece& piece : pieces_)
    impulses[piece.body] += colliders[piece.collider].body_impulse();
  for (const Piece& piece : pieces_) {
    geometry::Collider& collider = colliders[piece.collider];
    collider.set_body_velocity(collider.body_velocity() +
                               collider.body.mobility * impulses[piece.body]);
  }
}

template class Bodies<float, 2>;
template class Bodies<float, 3>;
template class Bodies<double, 2>;
template class Bodies<double, 3>;
template double Bodies<float, 2>::add_product(float, std::span<const float>, std::span<float>,
                                              int) const;
template double Bodies<float, 3>::add_product(float, std::span<const float>, std::span<float>,
                                              int) const;
template double Bodies<double, 2>::add_product(double, std::span<const double>, std::span<double>,
                                               int) const;
template double Bodies<double, 3>::add_product(double, std::span<const double>, std::span<double>,
                                               int) const;
template double Bodies<float, 2>::add_product(float, std::span<const double>, std::span<float>,
                                              int) const;
template double Bodies<float, 3>::add_product(float, std::span<const double>, std::span<float>,
                                              int) const;

}  // namespace substep::gridfluid
