// Electronic brake control: from the XBR deceleration demand to the supply pressure of each
// circuit.
#ifndef IITS_MJ_PLUGIN_BRAKE_CONTROL_H_
#define IITS_MJ_PLUGIN_BRAKE_CONTROL_H_

#include <mujoco/mujoco.h>

#include "plugin/dead_time.h"
#include "plugin/lookup.h"

namespace iits {

// What the controller remembers between steps.
struct BrakeControlState {
  double initialized;
  double supply[kCircuits];  // pressure at the outlet of the supply valve [Pa]
  double speed;              // of the vehicle, low-passed [m/s]
  double reference[2];  // demand as the brakes can follow it, then as the filter shows it [m/s2]
  double trim;          // added to the demand by the deceleration control [m/s2]
  double holding;       // 1: the brakes hold the standing vehicle
  double hold_time;     // since the demand ended, while holding [s]
};

struct BrakeDemand {
  double deceleration;  // demanded, >= 0 [m/s2]
  bool active;          // XBR asks for braking
  double speed;         // of the vehicle, forward [m/s]
  bool abs_active;
  double uphill_torque;  // brake torque that keeps the vehicle from rolling back [N m]
};

class BrakeControl {
 public:
  bool Read(const mjModel* m, int instance);  // false after a warning
  // `uphill_torque_min`: below it the vehicle would not roll back if the brakes let go.
  void set_uphill_torque_min(double torque) { uphill_torque_min_ = torque; }
  void set_response_time(double time) { response_time_ = time; }

  // Advances the supply pressures by h.
  void Update(const BrakeDemand& demand, double h, BrakeControlState* s) const;

 private:
  void Hold(const BrakeDemand& demand, double h, BrakeControlState* s) const;
  void Trim(const BrakeDemand& demand, double deceleration, double supplied, double h,
            BrakeControlState* s) const;

  Curve pressure_[kCircuits];  // over demanded deceleration
  double rise_rate_, fall_rate_, pressure_max_, hill_hold_time_;
  double uphill_torque_min_ = 0, response_time_ = 0.7;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_BRAKE_CONTROL_H_
