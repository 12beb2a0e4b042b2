#include "substep/gridfluid/viscosity/viscosity.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/linalg/vectors.h"

namespace substep::gridfluid {
namespace {

constexpr double kNearest = 0.05;  // theta, so that a step can be solved for
constexpr double kNear = 2;        // cells from a face, where an obstacle may strain with it
constexpr double kLeast = 1e-3;    // volume: less is none
constexpr double kBulk = 10;       // of the divergence: see viscosity.h
constexpr double kAway = 2.5;      // cells from the liquid where a face meets none of it

constexpr std::int64_t kRowsOfChunk = 256;

}  // namespace

template <class Real, int D>
Viscosity<Real, D>::Viscosity(const Layout<D>& layout, const OpenSides<D>& open, bool slip)
    : layout_(layout), open_(open), slip_(slip), volumes_(layout) {}

template <class Real, int D>
ViscosityReport Viscosity<Real, D>::apply(Obstacles<Real, D>& obstacles, std::span<const Real> phi,
                                          const ConstFaces<Real, D>& known, double k, double mass,
                                          Velocity<Real, D> u, double tolerance, int max_iterations,
                                          int threads) {
  k_ = k;
  volumes_.find(obstacles, phi, threads);
  find_rows(obstacles, phi, threads);
  pulls_.clear();
  system_.bodies.clear();
  if (face_.empty()) return {};
  poll_interrupt();
  find_matrix(obstacles, known, u, threads);
  const double energy =
      sum_terms<double>(system_.rows.size(), [&](std::size_t i) { return energy_[i]; }, threads);
  if (!std::isfinite(energy)) return {.iterations = 0, .converged = false, .finite = false};
  x_.resize(face_.size());
  add_bodies(obstacles, u, mass);
  const ViscosityReport report =
      system_.solve(b_, x_, tolerance * tolerance * energy, max_iterations, threads);
  for_each_index(face_.size(), threads, [&](std::size_t i) {
    u[system_.rows.component[i]][usize(face_[i])] += Real(x_[i]);
  });
  move_bodies(obstacles, u, threads);
  if (obstacles.any()) find_pulls(obstacles, u);
  hold(obstacles, u);
  for (const std::span<Real>& component : u) wrap(layout_, component, threads);
  return report;
}

// Faces in obstacles move with them, and what liquid is around them. The pressure of the divergence
// acts on what is open of them here, on the rest by add_pressure().
template <class Real, int D>
void Viscosity<Real, D>::hold(const Obstacles<Real, D>& obstacles, Velocity<Real, D> u) {
  for (std::size_t a = 0; a < D && obstacles.any(); ++a) {
    for (std::size_t f = 0; f < row_[a].size(); ++f) {
      if (row_[a][f] != kObstacle) continue;
      const auto face = static_cast<std::int64_t>(f);
      const double held = theirs(obstacles, a, face);
      double impulse = double(volumes_.of_face(a, face)) * (double(u[a][f]) - held);
      const auto open = double(obstacles.open(static_cast<int>(a))[f]);
      if (open > 0) impulse += open * pressed(obstacles, u, a, layout_.cell(face));
      if (impulse != 0) pulls_.push_back({a, face, impulse});
      u[a][f] = Real(held);
    }
  }
}

template <class Real, int D>
void Viscosity<Real, D>::mark(const Faces<Real, D>& known) const {
  for (std::size_t i = 0; i < face_.size(); ++i) known[system_.rows.component[i]][face_[i]] = 1;
}

// The velocity of an obstacle at a face in it.
template <class Real, int D>
double Viscosity<Real, D>::theirs(const Obstacles<Real, D>& obstacles, std::size_t axis,
                                  std::int64_t face) {
  return obstacles.moving() ? double(obstacles.velocity(static_cast<int>(axis))[usize(face)]) : 0;
}

// What holds a face, or kNone.
template <class Real, int D>
std::int32_t Viscosity<Real, D>::holder(const Obstacles<Real, D>& obstacles, std::size_t axis,
                                        std::int64_t face, const Place& place) const {
  const int at = place[axis], last = layout_.cells[axis];
  if (!layout_.periodic[axis] &&
      ((at == 0 && !open_[axis][0]) || (at == last && !open_[axis][1]))) {
    return kWall;
  }
  if (!obstacles.any()) return kNone;
  const bool held = obstacles.open(static_cast<int>(axis))[usize(face)] == 0 ||
                    (!slip_ && obstacles.at_face(face, axis) <= 0);
  return held ? kObstacle : kNone;
}

template <class Real, int D>
double Viscosity<Real, D>::volume(std::size_t a, std::size_t b, std::int64_t i) const {
  const auto v = double(a == b ? volumes_.of_cell(i) : volumes_.of_edge(a, b, i));
  return v < kLeast ? 0 : v;
}

// Whether there is liquid around a face, or one that strains with it.
template <class Real, int D>
bool Viscosity<Real, D>::moves(std::size_t axis, std::int64_t face, const Place& place) const {
  if (double(volumes_.of_face(axis, face)) >= kLeast) return true;
  bool any = false;
  for_strains(axis, place, [&](std::size_t a, std::size_t b, const Place& at) {
    any = any || (b != kAll && volume(a, b, layout_.index(at)) > 0);
  });
  return any;
}

template <class Real, int D>
void Viscosity<Real, D>::find_rows(const Obstacles<Real, D>& obstacles, std::span<const Real> phi,
                                   int threads) {
  face_.clear();
  VelocityRows<D>& rows = system_.rows;
  rows.cells = layout_.cells;
  rows.periodic = layout_.periodic;
  rows.colours.clear();
  rows.place.clear();
  rows.component.clear();
  for (std::size_t a = 0; a < D; ++a) {
    row_[a].assign(usize(layout_.size), kNone);
    Block<D> block = all_faces(layout_, a);
    if (layout_.periodic[a]) --block.to[a];
    using Faces = std::vector<std::int64_t>;
    const Faces faces = gather_rows(
        layout_, block, threads, Faces{},
        [&](std::int64_t begin, std::int64_t end) {
          Faces found;
          Place place = layout_.cell(begin);
          for (std::int64_t i = begin; i < end; ++i, ++place[D - 1]) {
            const Real near = std::min(phi[usize(i)], phi[usize(i - layout_.stride[a])]);
            if (near > Real(kAway)) continue;
            row_[a][usize(i)] = holder(obstacles, a, i, place);
            if (row_[a][usize(i)] == kNone && moves(a, i, place)) found.push_back(i);
          }
          return found;
        },
        [](Faces& all, const Faces& part) { all.insert(all.end(), part.begin(), part.end()); });
    for (const Face& face : held) {
      if (face.axis == a && row_[a][usize(face.index)] == kNone) row_[a][usize(face.index)] = kHeld;
    }
    order_rows(a, faces);
  }
}

// By colour: neighbours differ in the parity of their places, or in being the last along a periodic
// axis with an odd number.
template <class Real, int D>
void Viscosity<Real, D>::order_rows(std::size_t axis, const std::vector<std::int64_t>& faces) {
  VelocityRows<D>& rows = system_.rows;
  std::array<std::vector<std::int64_t>, usize(2 << D)> of_colour;
  for (const std::int64_t face : faces) {
    if (row_[axis][usize(face)] == kHeld) continue;
    const Place place = layout_.cell(face);
    int sum = 0, closes = 0;
    for (std::size_t a = 0; a < D; ++a) {
      const int n = layout_.cells[a];
      sum += place[a];
      if (layout_.periodic[a] && n % 2 == 1 && place[a] == n - 1) closes |= 1 << a;
    }
    of_colour[usize(2 * closes + (sum & 1))].push_back(face);
  }
  for (const std::vector<std::int64_t>& those : of_colour) {
    for (const std::int64_t face : those) {
      row_[axis][usize(face)] = static_cast<std::int32_t>(face_.size());
      face_.push_back(face);
      const Place place = layout_.cell(face);
      std::array<float, D> x;
      for (std::size_t a = 0; a < D; ++a)
        x[a] = static_cast<float>(place[a]) + (a == axis ? 0.0f : 0.5f);
      rows.place.push_back(x);
      rows.component.push_back(static_cast<std::uint8_t>(axis));
    }
    if (!those.empty()) rows.colours.push_back(static_cast<std::int64_t>(face_.size()));
  }
}

// Adds a component at `upper` less that below along an axis; false where there is no stress.
template <class Real, int D>
bool Viscosity<Real, D>::add_difference(const Obstacles<Real, D>& obstacles, std::size_t component,
                                        std::size_t along, const Place& upper,
                                        Strain& strain) const {
  const int n = layout_.cells[along];
  std::array<Term, 2> ends;
  bool side = false;
  for (std::size_t end = 0; end < 2; ++end) {
    Place place = upper;
    int& at = place[along];
    at -= end == 0 ? 1 : 0;
    if (layout_.periodic[along]) at = (at + n) % n;
    Term& term = ends[end];
    term = {.axis = component,
            .face = layout_.index(place),
            .row = kWall,
            .coefficient = end == 0 ? -1.0 : 1.0,
            .given = 0};
    if (component != along && (at < 0 || at >= n)) {  // beyond a side
      if (slip_ || open_[along][end]) return false;
      side = true;
      continue;
    }
    term.row = row_[component][usize(term.face)];
    if (term.row == kNone) return false;
    if (term.row == kObstacle) term.given = theirs(obstacles, component, term.face);
  }
  if (slip_ && (ends[0].row == kObstacle || ends[1].row == kObstacle)) {
    // Along what slips there is no stress, and across a slant the axes do not know which is which.
    if (component != along) return false;
    Place cell = upper;
    cell[along] = layout_.periodic[along] ? (cell[along] + n - 1) % n : cell[along] - 1;
    const auto area = obstacles.surface(layout_.index(cell));
    for (std::size_t b = 0; b < D; ++b) {
      if (b != along && area[b] != 0) return false;
    }
  }
  double scale = 1;
  if ((ends[0].row < 0) != (ends[1].row < 0)) {
    const Term& in = ends[ends[0].row < 0 ? 1 : 0];
    Term& out = ends[ends[0].row < 0 ? 0 : 1];
    if (side) {
      scale = 2;
    } else if (out.row == kObstacle) {
      const auto here = double(obstacles.at_face(in.face, component));
      const double there = std::min(double(obstacles.at_face(out.face, component)), 0.0);
      if (!slip_ && here > 0) {
        const double theta = std::max(here / (here - there), kNearest);
        scale = 1 / theta;
        out.given = (1 - theta) * theirs(obstacles, component, in.face) + theta * out.given;
        out.inner = 1 - theta;
      }
    }
  }
  for (Term& term : ends) {
    term.coefficient *= scale;
    strain.terms[usize(strain.count++)] = term;
  }
  return true;
}

// The weight is that of the square of e_aa, or of 2 e_ab.
template <class Real, int D>
auto Viscosity<Real, D>::strain(const Obstacles<Real, D>& obstacles, std::size_t a, std::size_t b,
                                const Place& place) const -> Strain {
  if (b == kAll) return divergence(obstacles, place);
  Strain strain;
  strain.weight = (a == b ? 2 : 1) * k_ * volume(a, b, layout_.index(place));
  if (strain.weight == 0) return strain;
  bool some = true;
  if (a == b) {
    Place upper = place;
    ++upper[a];
    some = add_difference(obstacles, a, a, upper, strain);
  } else {
    some = add_difference(obstacles, std::min(a, b), std::max(a, b), place, strain) &&
           add_difference(obstacles, std::max(a, b), std::min(a, b), place, strain);
  }
  strain.weight = some ? rounded(strain.weight) : 0;
  return strain;
}

// As the pressure sees it: what of a face is in an obstacle moves with that.
template <class Real, int D>
auto Viscosity<Real, D>::divergence(const Obstacles<Real, D>& obstacles, const Place& cell) const
    -> Strain {
  Strain strain;
  strain.weight = rounded(kBulk * k_ * volume(0, 0, layout_.index(cell)));
  if (strain.weight == 0) return strain;
  for (std::size_t a = 0; a < D; ++a) {
    for (int end = 0; end < 2; ++end) {
      Place place = cell;
      place[a] += end;
      if (layout_.periodic[a] && place[a] == layout_.cells[a]) place[a] = 0;
      const std::int64_t face = layout_.index(place);
      const std::int32_t row = row_[a][usize(face)];
      const double sign = end == 0 ? -1 : 1;
      Term& term = strain.terms[usize(strain.count++)];
      term = {.axis = a, .face = face, .row = row, .coefficient = sign, .given = 0};
      if (row == kNone) {
        strain.weight = 0;
        return strain;
      }
      if (!obstacles.any() || row == kWall) continue;
      const double held = theirs(obstacles, a, face);
      if (row == kObstacle) {
        term.given = held;
      } else {
        const auto open = double(obstacles.open(static_cast<int>(a))[usize(face)]);
        term.coefficient = sign * open;
        strain.given += sign * (1 - open) * held;
        term.covered = sign * (1 - open);
      }
    }
  }
  return strain;
}

// To a part of k, so that sums of some weights are exact in float.
template <class Real, int D>
double Viscosity<Real, D>::rounded(double weight) const {
  const double least = std::ldexp(1.0, std::ilogb(k_) - 20);
  return least > 0 ? least * std::round(weight / least) : 0;
}

// That of a cell which goes with its divergence, times dt / (density dx).
template <class Real, int D>
double Viscosity<Real, D>::pressure(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                                    const Place& cell) const {
  const Strain s = divergence(obstacles, cell);
  return s.weight > 0 ? -s.weight * rate(s, u) : 0;
}

// Of the cell below a face less that of the cell above it.
template <class Real, int D>
double Viscosity<Real, D>::pressed(const Obstacles<Real, D>& obstacles, const Velocity<Real, D>& u,
                                   std::size_t axis, const Place& face) const {
  double sum = 0;
  for (int end = 0; end < 2; ++end) {
    Place cell = face;
    int& at = cell[axis];
    const int n = layout_.cells[axis];
    at -= 1 - end;
    if (layout_.periodic[axis]) at = (at + n) % n;
    if (at >= 0 && at < n) sum += (end == 0 ? 1 : -1) * pressure(obstacles, u, cell);
  }
  return sum;
}

template <class Real, int D>
void Viscosity<Real, D>::add_pressure(const Obstacles<Real, D>& obstacles,
                                      const Velocity<Real, D>& u, std::span<const Cell> cells,
                                      std::span<double> q, int threads) const {
  for_rows(layout_, all_cells(layout_), threads, [&](std::int64_t begin, std::int64_t end) {
    Place place = layout_.cell(begin);
    for (std::int64_t i = begin; i < end; ++i, ++place[D - 1]) {
      if (cells[usize(i)] != Cell::kFluid) continue;
      q[usize(i)] += pressure(obstacles, u, place);
    }
  });
}

template <class Real, int D>
double Viscosity<Real, D>::rate(const Strain& strain, const Velocity<Real, D>& u) const {
  double sum = strain.given;
  for (int t = 0; t < strain.count; ++t) {
    const Term& term = strain.terms[usize(t)];
    const bool moves = term.row >= 0 || term.row == kHeld;
    sum += term.coefficient * (moves ? double(u[term.axis][usize(term.face)]) : term.given);
  }
  return sum;
}

template <class Real, int D>
void Viscosity<Real, D>::find_matrix(const Obstacles<Real, D>& obstacles,
                                     const ConstFaces<Real, D>& known, const Velocity<Real, D>& u,
                                     int threads) {
  system_.rows.reset(face_.size());
  b_.assign(face_.size(), 0.0);
  energy_.assign(face_.size(), 0.0);
  parallel_for(
      system_.rows.size(), kRowsOfChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t row = begin; row < end; ++row) find_row(obstacles, known, u, row);
      },
      threads);
}

// The derivative by the velocity of a face, for the change of all; the energy that it starts with.
template <class Real, int D>
void Viscosity<Real, D>::find_row(const Obstacles<Real, D>& obstacles,
                                  const ConstFaces<Real, D>& known, const Velocity<Real, D>& u,
                                  std::int64_t row) {
  VelocityRows<D>& rows = system_.rows;
  const std::int64_t face = face_[usize(row)];
  const std::size_t axis = rows.component[usize(row)];
  const double mass = known[axis][face] > 0 ? double(volumes_.of_face(axis, face)) : 0;
  double diagonal = mass, given = 0;
  for_strains(axis, layout_.cell(face), [&](std::size_t a, std::size_t b, const Place& place) {
    const Strain s = strain(obstacles, a, b, place);
    double own = 0, held = s.given;
    for (int t = 0; t < s.count; ++t) {
      const Term& term = s.terms[usize(t)];
      if (term.row == row) own += term.coefficient;
      if (term.row < 0) held += term.coefficient * term.given;
    }
    const double factor = s.weight * own;
    if (factor == 0) return;
    diagonal += factor * own;
    b_[usize(row)] -= factor * rate(s, u);
    given += factor * held;
    for (int t = 0; t < s.count; ++t) {
      const Term& term = s.terms[usize(t)];
      if (term.row >= 0 && term.row != row) rows.add(row, term.row, factor * term.coefficient);
    }
  });
  rows.diagonal[usize(row)] = diagonal > 0 ? diagonal : 1;
  const double drawn = given / rows.diagonal[usize(row)], now = double(u[axis][usize(face)]);
  energy_[usize(row)] = mass * (now * now + drawn * drawn);
}

// What strains with an obstacle pulls on it as on the liquid, the other way.
template <class Real, int D>
void Viscosity<Real, D>::find_pulls(const Obstacles<Real, D>& obstacles,
                                    const Velocity<Real, D>& u) {
  for (std::int64_t row = 0; row < system_.rows.size(); ++row) {
    const std::size_t axis = system_.rows.component[usize(row)];
    const std::int64_t face = face_[usize(row)];
    if (obstacles.at_face(face, axis) > kNear) continue;
    for_strains(axis, layout_.cell(face), [&](std::size_t a, std::size_t b, const Place& place) {
      if (b == kAll) return;  // a pressure
      const Strain s = strain(obstacles, a, b, place);
      for (int t = 0; t < s.count && s.weight > 0; ++t) {
        const Term &own = s.terms[usize(t)], &other = s.terms[usize(t ^ 1)];
        if (own.row == row && other.row == kObstacle)
          pulls_.push_back({axis, other.face, s.weight * own.coefficient * rate(s, u)});
      }
    });
  }
}

template <class Real, int D>
std::vector<geometry::Exchange> Viscosity<Real, D>::exchanges(const Obstacles<Real, D>& obstacles,
                                                              double mass) const {
  std::vector<geometry::Exchange> sums(obstacles.colliders.size());
  for (const Pull& pull : pulls_) {
    const int along = static_cast<int>(pull.axis);
    const Vec3 x = obstacles.middle(pull.face, along);
    const std::size_t c = obstacles.nearest(x);
    Vec3 impulse = Vec3::Zero();
    impulse[along] = mass * pull.impulse;
    sums[c].add(x - obstacles.colliders[c].position(), impulse);
  }
  for (const Yields& one : yielding_) {
    const geometry::Collider& collider = obstacles.colliders[one.collider];
    geometry::Exchange& sum = sums[one.collider];
    sum = exchange_of<D>(mass * one.push, collider);
  }
  return sums;
}

template class Viscosity<float, 2>;
template class Viscosity<float, 3>;
template class Viscosity<double, 2>;
template class Viscosity<double, 3>;

}  // namespace substep::gridfluid
