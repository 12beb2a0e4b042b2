#include "substep/rigid/shapes/shapes.h"

#include <cmath>
#include <limits>
#include <optional>
#include <sstream>
#include <type_traits>

#include "substep/core/errors.h"

namespace substep::rigid {
namespace {

// Takes the first kind of that name.
template <class S>
void make_if_named(const std::string& kind, const std::map<std::string, double>& numbers,
                   std::optional<Shape>& made) {
  if constexpr (requires { S::kName; }) {
    if (made || kind != S::kName) return;
    made = S::with([&](const char* name) {
      const auto found = numbers.find(name);
      if (found == numbers.end()) throw InputError(kind + ": expected a number " + name);
      return found->second;
    });
  }
}

template <class... Kinds>
std::optional<Shape> made_of(std::type_identity<std::variant<Kinds...>>, const std::string& kind,
                             const std::map<std::string, double>& numbers) {
  std::optional<Shape> made;
  (make_if_named<Kinds>(kind, numbers, made), ...);
  return made;
}

}  // namespace

void Expect::positive(const char* name, double value) const {
  if (value > 0 && std::isfinite(value)) return;
  std::ostringstream text;
  text << where << name << ": expected a finite number above 0, got " << value;
  throw InputError(text.str());
}

Shape make_shape(const std::string& kind, const std::map<std::string, double>& numbers) {
  const std::optional<Shape> made = made_of(std::type_identity<Shape>(), kind, numbers);
  if (!made) throw InputError("shape: there is no kind " + kind);
  return *made;
}

void check_shape(const Shape& shape, const std::string& where) {
  const auto check = [&](const auto& s) {
    if constexpr (requires { s.check(Expect{where}); }) {
      s.check(Expect{where});
    } else if (!s) {
      throw InputError(where + "shape: expected a hull or a mesh, got none");
    }
  };
  std::visit(check, shape);
}

Bounds bounds(const Shape& shape, const Pose& pose) {
  const auto of = [&](const auto& s) {
    if constexpr (requires { shape_of(s).bounds(pose); }) {
      return shape_of(s).bounds(pose);
    } else {
      return bounds_by_support(s, pose);
    }
  };
  return std::visit(of, shape);
}

Ball inner_ball(const Shape& shape) {
  const auto of = [](const auto& s) -> Ball {
    if constexpr (ConvexShape<decltype(s)>) {
      return shape_of(s).inner_ball();
    } else {
      return {Vec3::Zero(), std::numeric_limits<double>::infinity()};
    }
  };
  return std::visit(of, shape);
}

double outer_radius(const Shape& shape, const Pose& local) {
  return std::visit([&](const auto& s) { return shape_of(s).outer_radius(local); }, shape);
}

}  // namespace substep::rigid
