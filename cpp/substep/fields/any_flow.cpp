#include "substep/fields/any_flow.h"

#include <algorithm>
#include <variant>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/fields/flow_advection.h"

namespace substep::fields {
namespace {

template <class Flow>
class FlowOf final : public AnyFlow {
 public:
  explicit FlowOf(const Flow& flow) : flow_(flow) {}

  void velocity(double t, NumbersIn x, NumbersOut u, int threads) const override {
    each_precision(x, u, [&](auto in, auto out, std::int64_t count) {
      sample_flow(flow_, t, in, out, count, threads);
    });
  }
  void advect(const std::string& method, NumbersIn x, NumbersOut x_new, const Steps& steps,
              int threads) const override {
    each_precision(x, x_new, [&](auto in, auto out, std::int64_t count) {
      advect_flow(flow_, method, in, out, count, steps, threads);
    });
  }

 private:
  template <class Call>
  static void each_precision(NumbersIn x, NumbersOut out, const Call& call) {
    std::visit(
        [&]<class T>(std::span<const T> in) {
          const auto* to = std::get_if<std::span<T>>(&out);
          if (to == nullptr) throw InputError("x: expected the precision of the result");
          call(in.data(), to->data(), static_cast<std::int64_t>(in.size()) / Flow::kDimension);
        },
        x);
  }

  Flow flow_;
};

template <class Flow>
std::unique_ptr<AnyFlow> made(const Flow& flow) {
  return std::make_unique<FlowOf<Flow>>(flow);
}

}  // namespace

std::unique_ptr<AnyFlow> make_flow(const std::string& kind, int dimension,
                                   std::span<const double> p) {
  const bool plane = dimension == 2;
  const auto is = [&](const char* name, std::size_t parameters) {
    return kind == name && p.size() == parameters;
  };
  if (is("rigid_rotation", 6)) {
    const std::array<double, 3> omega{p[0], p[1], p[2]}, center{p[3], p[4], p[5]};
    if (plane) return made(RigidRotation<2>{omega, center});
    return made(RigidRotation<3>{omega, center});
  }
  if (is("shear", 3)) {
    const int flow = static_cast<int>(p[1]), gradient = static_cast<int>(p[2]);
    if (plane) return made(Shear<2>{p[0], flow, gradient});
    return made(Shear<3>{p[0], flow, gradient});
  }
  if (is("taylor_green", 3)) return made(TaylorGreen{p[0], p[1], p[2]});
  if (is("abc", 3)) return made(Abc{p[0], p[1], p[2]});
  if (is("double_gyre", 3)) return made(DoubleGyre{p[0], p[1], p[2]});
  throw InputError("flow: there is no " + kind + " of so many parameters");
}

std::vector<MethodTable> method_tables() {
  std::vector<MethodTable> tables;
  tableaux::for_each_method<tableaux::FixedMethods>([&]<class Method>(const Method&) {
    using Weights = tableaux::WholeWeights<Method>;
    MethodTable table;
    table.name = Method::name;
    for (int i = 0; i < Method::stages; ++i) {
      table.a.emplace_back(Method::a[i], Method::a[i] + i);
      table.b.push_back(static_cast<double>(Weights::b[usize(i)]));
      table.c.push_back(Method::c[i]);
    }
    table.divisor = static_cast<double>(Weights::divisor);
    tables.push_back(std::move(table));
  });
  return tables;
}

}  // namespace substep::fields
