// Load sensing: how a braking force is shared between the circuits, and the pressures it takes.
#ifndef IITS_MJ_PLUGIN_BRAKE_DISTRIBUTION_H_
#define IITS_MJ_PLUGIN_BRAKE_DISTRIBUTION_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "plugin/dead_time.h"

namespace iits {

// Shares of the force are tables over the deceleration for a light and a heavy vehicle; a vehicle's
// own are found between them by its mass.
class BrakeDistribution {
 public:
  bool Read(const mjModel* m, int instance);  // false after a warning
  // Braking force per pressure above push-out [N/Pa] that a wheel adds to its circuit.
  void AddWheel(int circuit, double slope) { slope_[circuit] += slope; }
  bool Present(int circuit) const { return slope_[circuit] > 0; }

  // Pressures [Pa] whose braking force is `friction` [N], while the propeller shaft gives
  // `shaft_force` at the driven wheels: these need the less friction.
  void Pressures(double friction, double shaft_force, double deceleration, double mass,
                 double pressure[kCircuits]) const;

 private:
  std::vector<double> demand_, light_, heavy_;  // shares row by row, a column per circuit
  double mass_light_, mass_heavy_, push_out_pressure_;
  double slope_[kCircuits] = {};
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_BRAKE_DISTRIBUTION_H_
