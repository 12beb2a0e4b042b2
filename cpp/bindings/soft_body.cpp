#include <pybind11/stl.h>

#include "arrays.h"
#include "substep/springs/tetrahedra.h"

namespace {

using namespace substep::springs;

// Elastic and, unless the damping time is 0, viscous.
std::vector<std::shared_ptr<Term>> tetrahedra_terms(const Reals& rest, const Indices& tetrahedra,
                                                    const Reals& young_modulus,
                                                    const Reals& poisson_ratio,
                                                    const std::string& model,
                                                    double relaxation_time) {
  const Positions positions(reinterpret_cast<const Vec3*>(rest.data()),
                            static_cast<std::size_t>(rest.shape(0)));
  const auto mesh = std::make_shared<Tetrahedra>(
      positions,
      std::vector<std::int32_t>(tetrahedra.data(), tetrahedra.data() + tetrahedra.size()),
      readable(young_modulus), readable(poisson_ratio));
  std::vector<std::shared_ptr<Term>> terms = {make_elastic_term(model, mesh)};
  if (relaxation_time > 0) terms.push_back(make_viscous_term(mesh, relaxation_time));
  return terms;
}

}  // namespace

void bind_soft_body(py::module_& m) {
  m.attr("elastic_models") = elastic_models();
  m.def("tetrahedra_terms", &tetrahedra_terms, py::arg("rest").noconvert(),
        py::arg("tetrahedra").noconvert(), py::arg("young_modulus").noconvert(),
        py::arg("poisson_ratio").noconvert(), py::arg("model"), py::arg("relaxation_time"));
}
