// Materials by name and number, for those who need none of their formulas.
#pragma once

#include <map>
#include <string>
#include <vector>

namespace substep::mpm {

struct MaterialConstants {
  std::string kind;
  std::map<std::string, double> values;  // in SI; yes is 1 and no is 0
};

// A number that a material keeps for each particle besides F.
struct StateField {
  const char* name;
  const char* unit;
  double initial;
};

struct MaterialFields {
  const char* kind;
  bool has_F;
  std::vector<StateField> own;
};

// Of every kind of material.
std::vector<MaterialFields> material_fields();

}  // namespace substep::mpm
