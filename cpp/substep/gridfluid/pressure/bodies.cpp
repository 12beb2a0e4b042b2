#include "substep/gridfluid/pressure/bodies.h"

#include <Eigen/LU>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {
namespace {

constexpr std::size_t kNoPiece = static_cast<std::size_t>(-1);

}  // namespace

template <class Real, int D>
void Bodies<Real, D>::find(const Obstacles<Real, D>& obstacles, std::span<const Real> inverse,
                           double mass) {
  mass_ = mass;
  inverse_ = inverse;
  bodies_.clear();
  pieces_.clear();
  std::vector<std::size_t> piece_of(obstacles.colliders.size(), kNoPiece);
  for (const std::vector<std::size_t>& body : geometry::colliders_by_body(obstacles.colliders)) {
    for (const std::size_t c : body) {
      piece_of[c] = pieces_.size();
      pieces_.push_back({c, bodies_.size(), {}});
    }
    const geometry::Mat6& mobility = obstacles.colliders[body[0]].body.mobility;
    bodies_.push_back({mass * mobility(kMotionPlaces<D>, kMotionPlaces<D>), {}, {}});
  }
  if (!any()) return;
  find_parts(obstacles, piece_of);
  find_terms();
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
  for (std::size_t a = 0; a < D; ++a) {
    const int axis = static_cast<int>(a);
    for (const auto& [face, c] : obstacles.faces_near(axis)) {
      const Real covered = 1 - obstacles.open(axis)[usize(face)];
      const std::size_t piece = piece_of[c];
      if (covered == 0 || piece == kNoPiece) continue;
      const std::int64_t below = face - obstacles.layout().stride[a];
      if (!(inverse_[usize(below)] > 0 || inverse_[usize(face)] > 0)) continue;
      const Vec3 arm = obstacles.middle(face, axis) - obstacles.colliders[c].centre();
      const Motion motion = double(covered) * motion_of<D>(arm, axis);
      add(piece, below, motion);
      add(piece, face, -motion);
    }
  }
}

template <class Real, int D>
void Bodies<Real, D>::find_terms() {
  std::vector<Mobility> n(bodies_.size(), Mobility::Zero());
  for (const Piece& piece : pieces_)
    for (const Part& part : piece.parts)
      n[piece.body] += double(inverse_[usize(part.cell)]) * part.motion * part.motion.transpose();
  for (std::size_t k = 0; k < bodies_.size(); ++k) {
    const Mobility& c = bodies_[k].c;
    const Mobility of_n = (Mobility::Identity() + n[k] * c).inverse();
    bodies_[k].t = c * of_n;
    bodies_[k].s = of_n.transpose() * bodies_[k].t;
    for (Mobility* const term : {&bodies_[k].t, &bodies_[k].s})
      *term = (0.5 * (*term + term->transpose())).eval();
  }
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
auto Bodies<Real, D>::take_moved(std::span<Real> r, int threads) const -> std::vector<Motion> {
  std::vector<Motion> kept = gather_bodies<true>(std::span<const Real>(r), threads), taken = kept;
  for (std::size_t k = 0; k < bodies_.size(); ++k) {
    taken[k] = -bodies_[k].t * kept[k];
    kept[k] = bodies_[k].s * kept[k];
  }
  scatter<false>(taken, r);
  return kept;
}

template <class Real, int D>
void Bodies<Real, D>::add_moved(std::vector<Motion> kept, std::span<Real> z, int threads) const {
  const std::vector<Motion> of_z = gather_bodies<false>(std::span<const Real>(z), threads);
  for (std::size_t k = 0; k < bodies_.size(); ++k) kept[k] -= bodies_[k].t * of_z[k];
  scatter<true>(kept, z);
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
