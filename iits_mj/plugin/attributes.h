// Attributes of a plugin: one table gives the names for MuJoCo, the bounds, and the place of each
// value.
#ifndef IITS_MJ_PLUGIN_ATTRIBUTES_H_
#define IITS_MJ_PLUGIN_ATTRIBUTES_H_

#include <mujoco/mujoco.h>

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

namespace iits {

// Warns "plugin instance '...': " and the message; returns false.
bool Refuse(const mjModel* m, int instance, const char* format, ...)
    __attribute__((format(printf, 3, 4)));

// One attribute: its name, and how it is read; `read` returns false after a warning.
struct Attribute {
  const char* name;
  std::function<bool(const mjModel* m, int instance, const char* name)> read;
};
using Attributes = std::vector<Attribute>;

// Reads all attributes in order; false after the first that is refused.
bool ReadAttributes(const mjModel* m, int instance, const Attributes& attributes);

// Reads an attribute as finite numbers within [low, high]; false after a warning that names
// instance, attribute, value and what is allowed. An attribute must be given.
bool ReadNumbers(const mjModel* m, int instance, const char* name, size_t count_min,
                 size_t count_max, double low, double high, std::vector<double>* out);

// Kinds of attributes. One number, rounded toward zero where `out` is an integer:
Attribute Number(const char* name, double low, double high, double* out);
Attribute Number(const char* name, double low, double high, int* out);
// `count_min` to `count_max` numbers, each greater (`order` 1) or less (-1) than the one before:
Attribute Ordered(const char* name, int order, size_t count_min, size_t count_max, double low,
                  double high, std::vector<double>* out);
// The axis of a curve or map: 2 to 64 increasing numbers.
Attribute Axis(const char* name, std::vector<double>* out);
// One value for each point of the axes, `columns` numbers a point:
Attribute Values(const char* name, double low, double high, std::vector<double>* out,
                 std::vector<const std::vector<double>*> axes, size_t columns = 1);

// The part of an element's name after the last '/', so that attached models keep working.
std::string LocalName(const char* name);

// The part up to and including the last '/', "" when there is none.
std::string NamePrefix(const char* name);

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_ATTRIBUTES_H_
