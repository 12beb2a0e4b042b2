#include "substep/gridfluid/pressure/bodies.h"

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::gridfluid {
namespace {

constexpr std::int64_t kNoCell = -1;
constexpr std::size_t kNoPiece = static_cast<std::size_t>(-1);

}  // namespace

template <class Real, int D>
void Bodies<Real, D>::find(const Obstacles<Real, D>& obstacles, std::span<const Real> inverse,
                           double mass) {
  mass_ = mass;
  bodies_.clear();
  pieces_.clear();
  std::vector<std::size_t> piece_of(obstacles.colliders.size(), kNoPiece);
  for (const std::vector<std::size_t>& body : geometry::colliders_by_body(obstacles.colliders)) {
    for (const std::size_t c : body) {
      piece_of[c] = pieces_.size();
      pieces_.push_back({c, bodies_.size(), {}});
    }
    const geometry::Mat6& mobility = obstacles.colliders[body[0]].body.mobility;
    bodies_.push_back(mass * mobility(kMotionPlaces<D>, kMotionPlaces<D>));
  }
  if (any()) find_parts(obstacles, inverse, piece_of);
}

template <class Real, int D>
void Bodies<Real, D>::find_parts(const Obstacles<Real, D>& obstacles, std::span<const Real> inverse,
                                 const std::vector<std::size_t>& piece_of) {
  const auto cell_at = [&](std::int64_t i) { return inverse[usize(i)] > 0 ? i : kNoCell; };
  for (std::size_t a = 0; a < D; ++a) {
    const int axis = static_cast<int>(a);
    for (const auto& [face, c] : obstacles.faces_near(axis)) {
      const Real covered = 1 - obstacles.open(axis)[usize(face)];
      const std::int64_t below = cell_at(face - obstacles.layout().stride[a]),
                         above = cell_at(face);
      if (covered == 0 || (below == kNoCell && above == kNoCell)) continue;
      const std::size_t piece = piece_of[c];
      if (piece == kNoPiece) continue;
      const Vec3 arm = obstacles.middle(face, axis) - obstacles.colliders[c].centre();
      const auto motion = motion_of<D>(arm, axis);
      Part& part = pieces_[piece].parts.emplace_back(Part{below, above, {}});
      for (int n = 0; n < kMotions; ++n)
        part.motion[usize(n)] = static_cast<Real>(double(covered) * motion[n]);
    }
  }
}

// G x of each piece.
template <class Real, int D>
template <class X>
auto Bodies<Real, D>::gather(std::span<const X> x, int threads) const -> std::vector<Motion> {
  std::vector<Motion> sums(pieces_.size());
  parallel_for(
      static_cast<std::int64_t>(pieces_.size()), 1,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t p = begin; p < end; ++p) {
          Motion sum = Motion::Zero();
          for (const Part& part : pieces_[usize(p)].parts) {
            const double below = part.below == kNoCell ? 0 : double(x[usize(part.below)]);
            const double above = part.above == kNoCell ? 0 : double(x[usize(part.above)]);
            for (int n = 0; n < kMotions; ++n)
              sum[n] += (below - above) * double(part.motion[usize(n)]);
          }
          sums[usize(p)] = sum;
        }
      },
      threads);
  return sums;
}

template <class Real, int D>
template <class X>
double Bodies<Real, D>::add_product(Real sign, std::span<const X> x, std::span<Real> y,
                                    int threads) const {
  std::vector<Motion> of_body(bodies_.size(), Motion::Zero());
  const std::vector<Motion> of_piece = gather(x, threads);
  for (std::size_t p = 0; p < pieces_.size(); ++p) of_body[pieces_[p].body] += of_piece[p];
  double product = 0;
  for (std::size_t k = 0; k < bodies_.size(); ++k) {
    const Motion moved = bodies_[k] * of_body[k];
    product += moved.dot(of_body[k]);
    of_body[k] = moved;
  }
  for (const Piece& piece : pieces_) {  // one after the other: two may be in one cell
    const Motion& moved = of_body[piece.body];
    for (const Part& part : piece.parts) {
      double sum = 0;
      for (int n = 0; n < kMotions; ++n) sum += double(part.motion[usize(n)]) * moved[n];
      if (part.below != kNoCell) y[usize(part.below)] += sign * Real(sum);
      if (part.above != kNoCell) y[usize(part.above)] -= sign * Real(sum);
    }
  }
  return product;
}

template <class Real, int D>
void Bodies<Real, D>::push(std::span<const double> q, std::vector<geometry::Collider>& colliders,
                           int threads) const {
  const std::vector<Motion> impulses = gather(q, threads);
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
