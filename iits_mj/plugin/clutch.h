// Clutch and elastic driveline: one torsional spring and damper that slips at the clutch's
// capacity.
#ifndef IITS_MJ_PLUGIN_CLUTCH_H_
#define IITS_MJ_PLUGIN_CLUTCH_H_

#include <algorithm>
#include <cmath>

namespace iits {

// One semi-implicit step of engine inertia against the elastic driveline.
//
//   J dw/dt = T_e - T,   T = k x + c dx/dt,   |T| <= capacity   (return mapping)
//
// The end-of-step engine speed enters T, so that the engine's side is stable at any step; the
// gearbox's speed is that of the step's start. In slip dx/dt is whatever keeps |T| at capacity.
struct ElasticClutch {
  double stiffness;  // at the gearbox input [N m/rad]
  double damping;    // at the gearbox input [N m s/rad]

  // Returns the clutch torque T, positive from the engine to the wheels; updates torsion and speed.
  double Step(double engine_torque, double inertia, double input_speed, double capacity, double h,
              double* torsion, double* engine_speed) const {
    double free_speed = *engine_speed + h * engine_torque / inertia;
    double gain = stiffness * h + damping;
    double torque =
        (stiffness * *torsion + gain * (free_speed - input_speed)) / (1 + gain * h / inertia);
    torque = std::clamp(torque, -capacity, capacity);
    *torsion = (h * torque + damping * *torsion) / gain;
    *engine_speed = std::max(0.0, free_speed - h * torque / inertia);
    return torque;
  }
};

// Engagement, 0 open to 1 closed, as a gearbox controller moves it while a gear is in.
struct ClutchControl {
  double idle_speed;           // [rad/s]
  double pedal_up;             // accelerator travel up to which nothing is launched
  double launch_share;         // engagement that carries the engine's reference torque
  double engagement_time;      // full travel at launch [s]
  double opening_time;         // full travel [s]
  double launch_range;         // engine speed above idle, to the reference torque [rad/s]
  double alike_range;          // speed difference at which the clutch closes for good [rad/s]
  double release_share;        // of idle: gearbox input speed below which it opens, pedal down
  double release_share_coast;  // the same, pedal up
  double stall_share;          // of idle: engine speed at which its capacity is gone
  double stall_range;          // of idle: above, to the whole capacity

  // Slips while the truck starts: torque grows with engine speed above idle, which finds the
  // engine's own torque by itself, cannot stall it, and is zero at idle. Closes for good when both
  // sides turn alike; opens near idle speed.
  double Update(double engagement, double engine_speed, double input_speed, double pedal,
                double h) const {
    bool powered = pedal >= pedal_up;
    double target = 0;
    if (input_speed > (powered ? release_share : release_share_coast) * idle_speed) {
      bool alike = std::abs(engine_speed - input_speed) < alike_range;
      double pulled = std::max(engine_speed, input_speed);
      target = alike || engagement >= 1 ? 1 : Launch(pulled);
    } else if (powered) {
      target = Launch(engine_speed);
    }
    return std::clamp(target, engagement - h / opening_time, engagement + h / engagement_time);
  }

  // Last guard: whatever the control does, the capacity is gone before the engine stalls.
  double StallGuard(double engine_speed) const {
    return std::clamp((engine_speed / idle_speed - stall_share) / stall_range, 0.0, 1.0);
  }

 private:
  double Launch(double speed) const {
    return std::clamp((speed - idle_speed) / launch_range, 0.0, 1.0) * launch_share;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_CLUTCH_H_
