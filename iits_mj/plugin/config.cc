#include "plugin/config.h"

#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

namespace iits {

std::string InstanceName(const mjModel* m, int instance) {
  const char* name = mj_id2name(m, mjOBJ_PLUGIN, instance);
  return name && name[0] ? name : "(unnamed)";
}

std::string LocalName(const char* name) {
  std::string text = name ? name : "";
  size_t slash = text.rfind('/');
  return slash == std::string::npos ? text : text.substr(slash + 1);
}

std::string NamePrefix(const char* name) {
  std::string text = name ? name : "";
  size_t slash = text.rfind('/');
  return slash == std::string::npos ? "" : text.substr(0, slash + 1);
}

bool ReadNumbers(const mjModel* m, int instance, const char* name, size_t count_min,
                 size_t count_max, double low, double high, std::vector<double>* out) {
  const char* text = mj_getPluginConfig(m, instance, name);
  if (!text || !text[0]) {
    if (!out->empty()) return true;
    mju_warning("plugin instance '%s': attribute '%s' is missing",
                InstanceName(m, instance).c_str(), name);
    return false;
  }
  std::vector<double> values;
  const char* cursor = text;
  while (true) {
    while (*cursor == ' ' || *cursor == '\t' || *cursor == '\n' || *cursor == '\r') ++cursor;
    if (!*cursor) break;
    char* end = nullptr;
    double value = std::strtod(cursor, &end);
    if (end == cursor || !std::isfinite(value) || value < low || value > high) {
      mju_warning(
          "plugin instance '%s': attribute '%s' has '%.40s'; allowed are numbers in [%g, %g]",
          InstanceName(m, instance).c_str(), name, cursor, low, high);
      return false;
    }
    values.push_back(value);
    cursor = end;
  }
  if (values.size() < count_min || values.size() > count_max) {
    mju_warning("plugin instance '%s': attribute '%s' has %zu numbers; allowed are %zu to %zu",
                InstanceName(m, instance).c_str(), name, values.size(), count_min, count_max);
    return false;
  }
  *out = values;
  return true;
}

bool ReadNumber(const mjModel* m, int instance, const char* name, double low, double high,
                double* out) {
  std::vector<double> values;
  if (!std::isnan(*out)) values.push_back(*out);
  if (!ReadNumbers(m, instance, name, 1, 1, low, high, &values)) return false;
  *out = values[0];
  return true;
}

}  // namespace iits
