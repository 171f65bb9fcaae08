// Attributes of a plugin: one table of their names in MuJoCo, their bounds and their variables.
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

// An attribute: its name and the function that reads it, which returns false after a warning.
struct Attribute {
  const char* name;
  std::function<bool(const mjModel* m, int instance, const char* name)> read;
};
using Attributes = std::vector<Attribute>;

// Reads all attributes in order; false after the first invalid one.
bool ReadAttributes(const mjModel* m, int instance, const Attributes& attributes);

// Reads a required attribute as finite numbers within [low, high]; false after a warning with
// instance, attribute, value and allowed values.
bool ReadNumbers(const mjModel* m, int instance, const char* name, size_t count_min,
                 size_t count_max, double low, double high, std::vector<double>* out);

// Whether the model has the attribute.
bool Given(const mjModel* m, int instance, const char* name);

// Kinds of attributes. One number, rounded toward zero where `out` is an integer:
Attribute Number(const char* name, double low, double high, double* out);
Attribute Number(const char* name, double low, double high, int* out);
// `count_min` to `count_max` numbers, each greater (`order` 1) or less (-1) than the one before:
Attribute Ordered(const char* name, int order, size_t count_min, size_t count_max, double low,
                  double high, std::vector<double>* out);
// The axis of a curve or map: 2 to 64 increasing numbers.
Attribute Axis(const char* name, std::vector<double>* out);
// One value for each point of the axes, with `columns` numbers per point:
Attribute Values(const char* name, double low, double high, std::vector<double>* out,
                 std::vector<const std::vector<double>*> axes, size_t columns = 1);
// Text:
Attribute Text(const char* name, std::string* out);
// One that may be missing; its variables then stay as they are:
Attribute Optional(Attribute attribute);
// One that is required if the attribute `other` is given, and refused without it:
Attribute Together(const char* other, Attribute attribute);

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_ATTRIBUTES_H_
