// Reading of plugin attributes: numbers with bounds, one clear warning on bad input.
#ifndef IITS_MJ_PLUGIN_CONFIG_H_
#define IITS_MJ_PLUGIN_CONFIG_H_

#include <mujoco/mujoco.h>

#include <limits>
#include <string>
#include <vector>

namespace iits {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Reads attribute `name` as whitespace-separated finite numbers within [low, high].
// Returns false after an mju_warning that names instance, attribute, value and what is allowed.
// An absent attribute yields `*out` unchanged when it is not empty (the default), else an error.
bool ReadNumbers(const mjModel* m, int instance, const char* name, size_t count_min,
                 size_t count_max, double low, double high, std::vector<double>* out);

// The same for one number; `*out` holds the default unless it is NaN (then the attribute must be
// given).
bool ReadNumber(const mjModel* m, int instance, const char* name, double low, double high,
                double* out);

// A number that must be given.
struct Attribute {
  const char* name;
  double low, high;
  double* value;
};

// Reads them all; false after the first that cannot be used.
template <size_t kCount>
bool ReadAttributes(const mjModel* m, int instance, const Attribute (&attributes)[kCount]) {
  for (const Attribute& a : attributes) {
    *a.value = std::numeric_limits<double>::quiet_NaN();
    if (!ReadNumber(m, instance, a.name, a.low, a.high, a.value)) return false;
  }
  return true;
}

// Name of the plugin instance, or "(unnamed)".
std::string InstanceName(const mjModel* m, int instance);

// The part of an element's name after the last '/', so that attached models keep working.
std::string LocalName(const char* name);

// The part up to and including the last '/', "" when there is none.
std::string NamePrefix(const char* name);

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_CONFIG_H_
