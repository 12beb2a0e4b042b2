// The place of a front's numbers; see supernodal_cholesky.h.
#pragma once

#include "substep/linalg/direct/panel_kernels.h"
#include "substep/linalg/direct/supernodal_cholesky.h"

namespace substep {

template <class Real>
std::int64_t panels(std::int64_t rows) {
  return (rows + kPanelRows<Real> - 1) / kPanelRows<Real>;
}
// Panel p of an update matrix holds the columns up to its own rows.
template <class Real>
std::int64_t update_offset(std::int64_t panel) {
  return kPanelRows<Real> * kPanelRows<Real> / 2 * panel * (panel + 1);
}

// A front: `columns` eliminated columns with `pivots` panels of their own rows and `below` panels
// of the `rows` rows below, all of them `columns` wide; its update matrix is rows x rows.
template <class Real>
struct SupernodalCholesky<Real>::Front {
  std::int64_t columns, rows, pivots, below;
  std::int64_t factor;   // offset of its panels
  std::int64_t inverse;  // offset of its first column
  std::int64_t update;   // first vertex of its update vector in solve()
  double flops;
  std::int64_t update_size() const { return update_offset<Real>(below); }
};

}  // namespace substep
