#include "plugin/lookup.h"

#include <mujoco/mujoco.h>

#include <vector>

#include "plugin/config.h"

namespace iits {
namespace {

constexpr size_t kPointsMax = 64;

bool ReadAxis(const mjModel* m, int instance, const char* name, std::vector<double>* out) {
  out->clear();
  if (!ReadNumbers(m, instance, name, 2, kPointsMax, -1e9, 1e9, out)) return false;
  for (size_t i = 1; i < out->size(); ++i) {
    if ((*out)[i] <= (*out)[i - 1]) {
      mju_warning("plugin instance '%s': attribute '%s' must increase, but %g follows %g",
                  InstanceName(m, instance).c_str(), name, (*out)[i], (*out)[i - 1]);
      return false;
    }
  }
  return true;
}

}  // namespace

bool ReadCurve(const mjModel* m, int instance, const char* x, const char* y, double low,
               double high, Curve* out) {
  if (!ReadAxis(m, instance, x, &out->x)) return false;
  out->y.clear();
  return ReadNumbers(m, instance, y, out->x.size(), out->x.size(), low, high, &out->y);
}

bool ReadMap(const mjModel* m, int instance, const char* rows, const char* columns,
             const char* values, double low, double high, Map* out) {
  if (!ReadAxis(m, instance, rows, &out->rows)) return false;
  if (!ReadAxis(m, instance, columns, &out->columns)) return false;
  size_t count = out->rows.size() * out->columns.size();
  out->values.clear();
  return ReadNumbers(m, instance, values, count, count, low, high, &out->values);
}

}  // namespace iits
