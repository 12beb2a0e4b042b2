// What holds between surfaces of two materials, where it does not follow from each alone.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace substep::rigid {

// What is not given follows the rule of all pairs (world.h); static friction follows friction.
struct MaterialPair {
  std::string a, b;  // names, in any order
  std::optional<double> friction = {}, static_friction = {}, restitution = {};
  std::optional<double> rolling = {}, spinning = {};  // [m]
};

class MaterialPairs {
 public:
  // In the place of what there was for the pair; one that gives nothing is taken out. InputError: a
  // number is out of range, or static friction is given and not at least friction.
  void set(MaterialPair pair);
  // nullptr if there is none.
  const MaterialPair* find(std::string_view a, std::string_view b) const {
    return pairs_.empty() || a.empty() || b.empty() ? nullptr : look_up(a, b);
  }
  std::span<const MaterialPair> all() const { return pairs_; }  // in the order of their names

 private:
  const MaterialPair* look_up(std::string_view a, std::string_view b) const;

  std::vector<MaterialPair> pairs_;  // a <= b
};

}  // namespace substep::rigid
