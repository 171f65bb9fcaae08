// Aerodynamics plugin `iits.aerodynamics`: drag and side force at the centre of pressure.
#ifndef IITS_MJ_PLUGIN_AERODYNAMICS_H_
#define IITS_MJ_PLUGIN_AERODYNAMICS_H_

#include <mujoco/mujoco.h>

#include <vector>

namespace iits {

// Every body that references the instance is a centre of pressure with its own frame; the wind is
// the model's `option/wind`. Stateless.
class Aerodynamics {
 public:
  static Aerodynamics* Create(const mjModel* m, int instance);  // null after a warning
  void Passive(const mjModel* m, mjData* d) const;

 private:
  Aerodynamics() = default;

  std::vector<int> bodies_;
  // Attributes, see README.md.
  double density_, drag_area_, side_area_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_AERODYNAMICS_H_
