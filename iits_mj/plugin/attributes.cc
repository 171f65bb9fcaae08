#include "plugin/attributes.h"

#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>

namespace iits {

bool Refuse(const mjModel* m, int instance, const char* format, ...) {
  char message[2048];
  va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(message, sizeof(message), format, arguments);
  va_end(arguments);
  const char* name = mj_id2name(m, mjOBJ_PLUGIN, instance);
  mju_warning("plugin instance '%s': %s", name && name[0] ? name : "(unnamed)", message);
  return false;
}

bool ReadAttributes(const mjModel* m, int instance, const Attributes& attributes) {
  for (const Attribute& a : attributes) {
    if (!a.read(m, instance, a.name)) return false;
  }
  return true;
}

bool Given(const mjModel* m, int instance, const char* name) {
  const char* value = mj_getPluginConfig(m, instance, name);
  return value && value[0];
}

bool ReadNumbers(const mjModel* m, int instance, const char* name, size_t count_min,
                 size_t count_max, double low, double high, std::vector<double>* out) {
  out->clear();
  if (!Given(m, instance, name)) return Refuse(m, instance, "attribute '%s' is missing", name);
  const char* cursor = mj_getPluginConfig(m, instance, name);
  while (true) {
    while (*cursor == ' ' || *cursor == '\t' || *cursor == '\n' || *cursor == '\r') ++cursor;
    if (!*cursor) break;
    char* end = nullptr;
    const double value = std::strtod(cursor, &end);
    if (end == cursor || !std::isfinite(value) || value < low || value > high) {
      return Refuse(m, instance, "attribute '%s' has '%.40s'; allowed are numbers in [%g, %g]",
                    name, cursor, low, high);
    }
    out->push_back(value);
    cursor = end;
  }
  if (out->size() >= count_min && out->size() <= count_max) return true;
  return Refuse(m, instance, "attribute '%s' has %zu numbers; allowed are %zu to %zu", name,
                out->size(), count_min, count_max);
}

Attribute Number(const char* name, double low, double high, double* out) {
  return {name, [=](const mjModel* m, int instance, const char* key) {
            std::vector<double> value;
            if (!ReadNumbers(m, instance, key, 1, 1, low, high, &value)) return false;
            *out = value[0];
            return true;
          }};
}

Attribute Number(const char* name, double low, double high, int* out) {
  return {name, [=](const mjModel* m, int instance, const char* key) {
            double value;
            if (!Number(key, low, high, &value).read(m, instance, key)) return false;
            *out = static_cast<int>(value);
            return true;
          }};
}

Attribute Ordered(const char* name, int order, size_t count_min, size_t count_max, double low,
                  double high, std::vector<double>* out) {
  return {name, [=](const mjModel* m, int instance, const char* key) {
            if (!ReadNumbers(m, instance, key, count_min, count_max, low, high, out)) return false;
            for (size_t i = 1; i < out->size(); ++i) {
              const double before = (*out)[i - 1], value = (*out)[i];
              if (order * (value - before) > 0) continue;
              return Refuse(m, instance, "attribute '%s' must %s, but %g follows %g", key,
                            order > 0 ? "increase" : "fall", value, before);
            }
            return true;
          }};
}

Attribute Axis(const char* name, std::vector<double>* out) {
  return Ordered(name, 1, 2, 64, -1e9, 1e9, out);
}

Attribute Values(const char* name, double low, double high, std::vector<double>* out,
                 std::vector<const std::vector<double>*> axes, size_t columns) {
  return {name, [=](const mjModel* m, int instance, const char* key) {
            size_t count = columns;
            for (const std::vector<double>* axis : axes) count *= axis->size();
            return ReadNumbers(m, instance, key, count, count, low, high, out);
          }};
}

Attribute Text(const char* name, std::string* out) {
  return {name, [out](const mjModel* m, int instance, const char* key) {
            const char* value = mj_getPluginConfig(m, instance, key);
            *out = value ? value : "";
            return true;
          }};
}

Attribute Optional(Attribute attribute) {
  return {attribute.name, [read = attribute.read](const mjModel* m, int instance, const char* key) {
            return !Given(m, instance, key) || read(m, instance, key);
          }};
}

Attribute Together(const char* other, Attribute attribute) {
  return {attribute.name,
          [other, read = attribute.read](const mjModel* m, int instance, const char* key) {
            if (Given(m, instance, other)) return read(m, instance, key);
            return !Given(m, instance, key) ||
                   Refuse(m, instance, "attribute '%s' needs '%s', which is missing", key, other);
          }};
}

}  // namespace iits
