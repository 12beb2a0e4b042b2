// Transforms of lines of n numbers that make second differences diagonal,
//   (A x)_i = (x_i - x_{i-1}) + (x_i - x_{i+1}),
// with x_{-1} = x_0 at a wall, x_{-1} = -x_0 at an open end (0 half a cell beyond the middle of the
// first), x_{-1} = x_{n-1} on a periodic line. The eigenvectors are, for k from 0 to n - 1, of
//   two walls     cos(pi k (i + 1/2) / n)          DCT-II     open ends  (-1)^i times those: DST-II
//   wall and open cos(pi (k + 1/2) (i + 1/2) / n)  DCT-IV     periodic   a real Fourier transform
// (Strang, "The discrete cosine transform", 1999).
//
// All of them are a complex Fourier transform z of two real lines at once, their numbers in an
// order and with factors of their own (DCT-II: Makhoul, "A fast cosine transform in one and two
// dimensions", 1980), whose coefficients k and n - k are turned by an angle; the periodic one with
// the order as it is and the angle 0. A DCT-IV is a DCT-II of x_i 2 cos(pi (i + 1/2) / 2n), whose
// coefficients are D_k = X_k + X_{k-1} (Kok, "Fast algorithm for computing discrete cosine
// transform", 1997).
#pragma once

#include <cstdint>
#include <vector>

#include "substep/core/usize.h"

namespace substep::gridfluid {

enum class LineEnds { kWalls, kOpen, kWallOpen, kOpenWall, kPeriodic };

class LineTransform {
 public:
  static bool can(int n);  // whether its prime factors are at most 13
  LineTransform(int n, LineEnds ends);

  int size() const { return n_; }
  // Where number i of the lines belongs in z for forward(), after multiplication by factor(i), and
  // where backward() leaves it, to be multiplied by factor(i) and scale().
  int place(int i) const { return place_[usize(i)]; }
  double factor(int i) const { return factor_[usize(i)]; }
  double scale() const { return 0.5 / n_; }
  // Of coefficient k, which forward() leaves at k.
  double eigenvalue(int k) const { return eigenvalue_[usize(k)]; }
  // z: number i of line l at kLines i + l (packet.h).
  void forward(double* z) const;
  void backward(double* z) const;

 private:
  struct Stage {
    int radix, block;     // joins `radix` transforms of `block` numbers
    std::size_t twiddle;  // the first of its own
  };
  void turn(double* z) const;
  void turn_back(double* z) const;

  int n_;
  bool mixed_;
  std::vector<int> place_;
  std::vector<double> factor_, eigenvalue_;
  std::vector<Stage> stages_;
  // cos and -sin of 2 pi q k / (radix block) for k below block and 0 < q < radix; cos and sin of
  // the angle of k.
  std::vector<double> twiddles_, turns_;
};

}  // namespace substep::gridfluid
