// Obstacles as they were, for simulations that go back.
#pragma once

#include <memory>
#include <vector>

#include "substep/geometry/collider.h"

namespace substep::geometry {

class KeptColliders {
 public:
  using Colliders = std::vector<std::shared_ptr<Collider>>;

  void keep(const Colliders& colliders) {
    kept_.clear();
    for (const auto& collider : colliders) kept_.push_back(*collider);
  }
  void rewind(const Colliders& colliders) const {
    for (std::size_t c = 0; c < kept_.size(); ++c) *colliders[c] = kept_[c];
  }

 private:
  std::vector<Collider> kept_;
};

}  // namespace substep::geometry
