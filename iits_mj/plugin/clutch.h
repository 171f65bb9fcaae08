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
  double idle_speed;       // [rad/s]
  double engagement_time;  // full travel at launch [s]
  double launch_share;     // engagement that carries the engine's reference torque

  // Slips while the truck starts: torque grows with engine speed above idle, which finds the
  // engine's own torque by itself, cannot stall it, and is zero at idle. Closes for good when both
  // sides turn alike; opens near idle speed.
  double Update(double engagement, double engine_speed, double input_speed, double pedal,
                double h) const {
    bool powered = pedal > 0.01;
    double release_speed = (powered ? 0.92 : 1.05) * idle_speed;
    double target = 0;
    if (input_speed > release_speed) {
      bool alike = std::abs(engine_speed - input_speed) < 0.06 * idle_speed;
      double pulled = std::max(engine_speed, input_speed);
      target = alike || engagement > 0.99 ? 1 : Launch(pulled);
    } else if (powered) {
      target = Launch(engine_speed);
    }
    double closing = h / engagement_time;
    return std::clamp(target, engagement - kOpeningRate * h, engagement + closing);
  }

  // Last guard: whatever the control does, the capacity is gone before the engine stalls.
  double StallGuard(double engine_speed) const {
    return std::clamp(10 * (engine_speed / idle_speed - 0.8), 0.0, 1.0);
  }

 private:
  static constexpr double kOpeningRate = 10.0;  // [1/s]
  static constexpr double kLaunchRange = 40.0;  // above idle, to the reference torque [rad/s]

  double Launch(double speed) const {
    return std::clamp((speed - idle_speed) / kLaunchRange, 0.0, 1.0) * launch_share;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_CLUTCH_H_
