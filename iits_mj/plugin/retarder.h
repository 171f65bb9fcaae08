// Hydrodynamic retarder on the propeller shaft: torque, filling and emptying, heat.
#ifndef IITS_MJ_PLUGIN_RETARDER_H_
#define IITS_MJ_PLUGIN_RETARDER_H_

#include <mujoco/mujoco.h>

namespace iits {

// What the retarder remembers between steps.
struct RetarderState {
  double fill;  // of the torque that full filling would give now, 0 to 1
  double heat;  // of oil and coolant: 0 cold, 1 what the continuous power ends at
};

class Retarder {
 public:
  // Reads the attributes; false after a warning. A torque_max of 0 is a truck without retarder.
  bool Read(const mjModel* m, int instance);

  double torque_max() const { return torque_max_; }

  // Torque of the full retarder at this shaft speed and heat, >= 0; none in reverse. With constant
  // filling the torque grows with the square of the speed; above, the control holds it at its
  // rating, and then at the power that the cooling can take.
  double Available(double shaft_speed, double heat) const;

  // Fills towards `wanted` of `available` [N m] and heats by the power of this step. Returns the
  // torque against the shaft's rotation.
  double Update(double wanted, double available, double shaft_speed, double h,
                RetarderState* s) const;

 private:
  double torque_max_;         // rating [N m]
  double full_torque_speed_;  // of the shaft, from which the rating is reached [rad/s]
  double power_max_, power_continuous_;
  double heat_time_;    // time constant of the heat [s]
  double derate_heat_;  // heat at which the derating begins
  double fill_time_, empty_time_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_RETARDER_H_
