#include "substep/gridfluid/pressure/line_transform.h"

#include <array>
#include <cmath>
#include <initializer_list>
#include <numbers>
#include <utility>

#include "substep/gridfluid/pressure/packet.h"

namespace substep::gridfluid {
namespace {

constexpr std::initializer_list<int> kRadices{4, 2, 3, 5, 7, 11, 13};

// cos and sin of 2 pi a / n.
std::pair<double, double> on_circle(std::int64_t a, std::int64_t n) {
  const long double angle =
      2 * std::numbers::pi_v<long double> * static_cast<long double>(a % n) / n;
  return {static_cast<double>(std::cos(angle)), static_cast<double>(std::sin(angle))};
}

SUBSTEP_INLINE Packet packet(const double* from) { return load<Packet>(from); }
SUBSTEP_INLINE void put(const Packet& v, double* to) { std::memcpy(to, &v, sizeof v); }

template <int kRadix>
using Complex = std::array<std::array<Packet, std::size_t{kRadix}>, 2>;

// cos and sin of 2 pi k / kRadix.
template <int kRadix>
const auto kCircle = [] {
  std::array<std::pair<double, double>, std::size_t{kRadix}> circle;
  for (int k = 0; k < kRadix; ++k) circle[usize(k)] = on_circle(k, kRadix);
  return circle;
}();

// z_p = sum_q z_q exp(-2 pi i p q / kRadix), for odd ones with the sums and differences of q and
// kRadix - q.
template <int kRadix>
SUBSTEP_INLINE void transform(Complex<kRadix>& z) {
  auto& [re, im] = z;
  if constexpr (kRadix == 2) {
    for (auto* x : {&re, &im}) *x = {(*x)[0] + (*x)[1], (*x)[0] - (*x)[1]};
  } else if constexpr (kRadix == 4) {
    const Packet a = re[0] + re[2], b = re[0] - re[2], c = re[1] + re[3], d = re[1] - re[3];
    const Packet e = im[0] + im[2], f = im[0] - im[2], g = im[1] + im[3], h = im[1] - im[3];
    re = {a + c, b + h, a - c, b - h};
    im = {e + g, f - d, e - g, f + d};
  } else {
    constexpr std::size_t kHalf = kRadix / 2;
    Complex<kHalf + 1> sum, difference;
    for (std::size_t part : {0, 1}) {
      sum[part][0] = z[part][0];
      for (std::size_t q = 1; q <= kHalf; ++q) {
        sum[part][q] = z[part][q] + z[part][kRadix - q];
        difference[part][q] = z[part][q] - z[part][kRadix - q];
        z[part][0] += sum[part][q];
      }
    }
    for (std::size_t p = 1; p <= kHalf; ++p) {
      Packet even_re = sum[0][0], even_im = sum[1][0], odd_re{}, odd_im{};
      for (std::size_t q = 1; q <= kHalf; ++q) {
        const auto [c, s] = kCircle<kRadix>[p * q % kRadix];
        even_re = fma(c, sum[0][q], even_re), even_im = fma(c, sum[1][q], even_im);
        odd_re = fma(s, difference[0][q], odd_re), odd_im = fma(s, difference[1][q], odd_im);
      }
      re[p] = even_re + odd_im, im[p] = even_im - odd_re;
      re[kRadix - p] = even_re - odd_im, im[kRadix - p] = even_im + odd_re;
    }
  }
}

// Transforms of radix * block numbers from those of block each, in place (decimation in time); or,
// with real and imaginary parts exchanged, those back (in frequency), times radix.
template <int kRadix, bool kBackward>
void join(double* z, int n, int block, const double* twiddles) {
  constexpr int kRe = kBackward ? kPacket : 0, kIm = kPacket - kRe;
  const auto along = [&](int k, const double* w) {
    for (double *at = z + k * kLines, *end = z + n * kLines; at < end;
         at += kRadix * block * kLines) {
      Complex<kRadix> x;
      for (std::size_t q = 0; q < kRadix; ++q) {
        const double* const from = at + static_cast<int>(q) * block * kLines;
        x[0][q] = packet(from + kRe), x[1][q] = packet(from + kIm);
      }
      const auto twiddle = [&] {
        for (std::size_t q = 1; q < kRadix && k > 0; ++q) {
          const double c = w[2 * q - 2], s = w[2 * q - 1];
          const Packet re = x[0][q], im = x[1][q];
          x[0][q] = fma(c, re, Packet(-s * im));
          x[1][q] = fma(c, im, Packet(s * re));
        }
      };
      if (!kBackward) twiddle();
      transform<kRadix>(x);
      if (kBackward) twiddle();
      for (std::size_t q = 0; q < kRadix; ++q) {
        double* const to = at + static_cast<int>(q) * block * kLines;
        put(x[0][q], to + kRe), put(x[1][q], to + kIm);
      }
    }
  };
  for (int k = 0; k < block; ++k) along(k, twiddles + 2 * (kRadix - 1) * k);
}

template <bool kBackward>
void join(int radix, double* z, int n, int block, const double* twiddles) {
  switch (radix) {
    case 2:
      return join<2, kBackward>(z, n, block, twiddles);
    case 3:
      return join<3, kBackward>(z, n, block, twiddles);
    case 4:
      return join<4, kBackward>(z, n, block, twiddles);
    case 5:
      return join<5, kBackward>(z, n, block, twiddles);
    case 7:
      return join<7, kBackward>(z, n, block, twiddles);
    case 11:
      return join<11, kBackward>(z, n, block, twiddles);
    case 13:
      return join<13, kBackward>(z, n, block, twiddles);
    default:
      return;
  }
}

}  // namespace

bool LineTransform::can(int n) {
  for (const int radix : kRadices) {
    while (n % radix == 0) n /= radix;
  }
  return n == 1;
}

LineTransform::LineTransform(int n, LineEnds ends)
    : n_(n), mixed_(ends == LineEnds::kWallOpen || ends == LineEnds::kOpenWall) {
  const bool periodic = ends == LineEnds::kPeriodic;
  int block = 1;
  for (const int radix : kRadices) {
    for (; n / block % radix == 0; block *= radix) {
      stages_.push_back({radix, block, twiddles_.size()});
      for (int k = 0; k < block; ++k) {
        for (int q = 1; q < radix; ++q) {
          const auto [c, s] = on_circle(std::int64_t{q} * k, radix * block);
          twiddles_.insert(twiddles_.end(), {c, -s});
        }
      }
    }
  }
  for (int i = 0; i < n; ++i) {
    const int cell = ends == LineEnds::kOpenWall ? n - 1 - i : i;
    int j = periodic ? cell : cell % 2 == 0 ? cell / 2 : n - 1 - cell / 2;  // Makhoul
    int place = 0;
    for (std::size_t s = stages_.size(); s-- > 0; j /= stages_[s].radix) {
      place += j % stages_[s].radix * stages_[s].block;
    }
    place_.push_back(place);
    const double sign = ends == LineEnds::kOpen && cell % 2 == 1 ? -1 : 1;
    factor_.push_back(mixed_ ? 2 * on_circle(2 * cell + 1, 8 * std::int64_t{n}).first : sign);
  }
  for (int k = 0; k < n; ++k) {  // 4 sin^2 of half the phase from cell to cell
    const std::int64_t half = periodic ? 4 * k : mixed_ ? 2 * k + 1 : 2 * k;
    const double s =
        on_circle(ends == LineEnds::kOpen ? 2 * (n - k) : half, 8 * std::int64_t{n}).second;
    eigenvalue_.push_back(4 * s * s);
    const auto [c, t] = on_circle(periodic ? 0 : k, 4 * std::int64_t{n});
    turns_.insert(turns_.end(), {c, t});
  }
}

// With the transforms V = R + i I of the two lines, z_k = V1_k + i V2_k, X_k = c R_k + s I_k and
// X_{n-k} = s R_k - c I_k; all times 2.
void LineTransform::turn(double* z) const {
  for (int k = 0; k <= n_ / 2; ++k) {
    const double c = turns_[usize(2 * k)], s = turns_[usize(2 * k + 1)];
    double *const at = z + k * kLines, *const mirror = z + (n_ - k) * kLines;
    const Packet a = packet(at), b = packet(at + kPacket);
    if (k == 0 || 2 * k == n_) {
      put(2 * c * a, at), put(2 * c * b, at + kPacket);
      continue;
    }
    const Packet e = packet(mirror), f = packet(mirror + kPacket);
    const Packet re1 = a + e, im1 = b - f, re2 = b + f, im2 = e - a;
    put(fma(c, re1, Packet(s * im1)), at), put(fma(c, re2, Packet(s * im2)), at + kPacket);
    put(fma(s, re1, Packet(-c * im1)), mirror);
    put(fma(s, re2, Packet(-c * im2)), mirror + kPacket);
  }
}

// R_k = c X_k + s X_{n-k}, I_k = s X_k - c X_{n-k}.
void LineTransform::turn_back(double* z) const {
  for (int k = 0; k <= n_ / 2; ++k) {
    const double c = turns_[usize(2 * k)], s = turns_[usize(2 * k + 1)];
    double *const at = z + k * kLines, *const mirror = z + (n_ - k) * kLines;
    const Packet a = packet(at), b = packet(at + kPacket);
    if (k == 0 || 2 * k == n_) {
      put(a / c, at), put(b / c, at + kPacket);
      continue;
    }
    const Packet e = packet(mirror), f = packet(mirror + kPacket);
    const Packet re1 = fma(c, a, Packet(s * e)), im1 = fma(s, a, Packet(-c * e));
    const Packet re2 = fma(c, b, Packet(s * f)), im2 = fma(s, b, Packet(-c * f));
    put(re1 - im2, at), put(im1 + re2, at + kPacket);
    put(re1 + im2, mirror), put(re2 - im1, mirror + kPacket);
  }
}

void LineTransform::forward(double* z) const {
  for (const Stage& stage : stages_) {
    join<false>(stage.radix, z, n_, stage.block, twiddles_.data() + stage.twiddle);
  }
  turn(z);
  if (!mixed_) return;
  for (int i = 0; i < kLines; ++i) z[i] /= 2;
  for (int i = kLines; i < n_ * kLines; ++i) z[i] -= z[i - kLines];
}

void LineTransform::backward(double* z) const {
  for (int i = (n_ - 1) * kLines - 1; mixed_ && i >= 0; --i) z[i] -= z[i + kLines];
  turn_back(z);
  for (std::size_t s = stages_.size(); s-- > 0;) {
    const Stage& stage = stages_[s];
    join<true>(stage.radix, z, n_, stage.block, twiddles_.data() + stage.twiddle);
  }
}

}  // namespace substep::gridfluid
