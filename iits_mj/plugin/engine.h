// Diesel engine: pedal map, governors, torque rates and boost lag, engine brake, fuel.
#ifndef IITS_MJ_PLUGIN_ENGINE_H_
#define IITS_MJ_PLUGIN_ENGINE_H_

#include <mujoco/mujoco.h>

#include <algorithm>

#include "plugin/lookup.h"

namespace iits {

// What the engine remembers between steps.
struct EngineState {
  double speed;          // of the crankshaft [rad/s]
  double torque;         // indicated by combustion, before friction, >= 0 [N m]
  double boost_demand;   // rate-limited indicated torque that the charge pressure follows [N m]
  double boost;          // indicated torque that the charge pressure can burn now [N m]
  double idle_integral;  // of the idle governor [N m]
  double brake_torque;   // of the engine brake, >= 0 [N m]
};

// What the curves give at one speed; found once a step.
struct EnginePoint {
  double speed;      // [rad/s]
  double drag;       // friction and pumping torque, >= 0 [N m]
  double limit;      // greatest brake torque, with the top governor's droop [N m]
  double brake_max;  // of the engine brake, >= 0 [N m]
};

// What pedal and gearbox ask of the engine in this step.
struct EngineRequest {
  enum Mode {
    kPedal,  // torque by pedal and governors
    kCut,    // torque down to zero within time_left, before the clutch opens
    kSpeed,  // synchronize: bring the free engine to target_speed
  };
  Mode mode;
  double pedal;          // 0 to 1
  double engine_brake;   // fraction of what is available, 0 to 1
  double time_left;      // kCut [s]
  double target_speed;   // kSpeed [rad/s]
  double inertia;        // kSpeed: what turns with the crankshaft [kg m2]
  bool limited = false;  // kPedal: another controller takes torque away, faster than a pedal does
  double torque = 0;     // kPedal: brake torque that the pedal asks for at the present speed [N m]
};

// Until the engine's torque has reached a level.
struct TorqueRecovery {
  double impulse;  // angular, that is missing until then [N m s]
  double time;     // [s]
};

class Engine {
 public:
  // Reads the attributes; false after a warning.
  bool Read(const mjModel* m, int instance);

  double idle_speed() const { return idle_speed_; }
  double governed_speed() const { return governed_speed_; }
  double reference_torque() const { return reference_torque_; }
  double inertia() const { return inertia_; }
  double brake_speed() const { return brake_speed_; }
  double rated_brake_torque() const { return brake_power_ / brake_speed_; }
  double pedal_up() const { return pedal_up_; }

  // How brake torque comes back to `level` from zero, after a pause of the combustion in which the
  // turbocharger has lost charge. `before` is the torque before the pause, `demand` the pedal's
  // after it. The integral of UpdateBoost.
  TorqueRecovery Recovery(double before, double pause, double demand, double level,
                          double drag) const;
  // The same without a pause, from the torque `before`.
  TorqueRecovery BuildUp(double before, double demand, double level, double drag) const;

  EnginePoint At(double speed) const;
  // Friction and pumping torque, >= 0.
  double Drag(double speed) const { return drag_(speed); }
  // Greatest brake torque, with the top governor's droop.
  double TorqueLimit(double speed) const { return Limit(speed, drag_(speed)); }
  // Brake torque that this pedal asks for, -drag with the pedal up.
  double PedalTorque(double speed, double pedal) const {
    const double drag = drag_(speed);
    return PedalTorque({speed, drag, Limit(speed, drag), 0}, pedal);
  }
  double PedalTorque(const EnginePoint& at, double pedal) const;
  // Torque at the crankshaft: combustion less friction and engine brake.
  double BrakeTorque(const EnginePoint& at, const EngineState& s) const {
    return s.torque - at.drag - s.brake_torque;
  }
  // [kg/s], from indicated torque and speed.
  double FuelRate(const EnginePoint& at, const EngineState& s) const;

  // Advances torque, boost, idle governor and engine brake by h; the speed is the clutch's affair.
  void Update(const EngineRequest& request, const EnginePoint& at, double h, EngineState* s) const;

 private:
  double Limit(double speed, double drag) const;
  TorqueRecovery BoostRecovery(double demand, double boost, double wanted, double reached) const;
  double IdleTorque(const EnginePoint& at, double h, EngineState* s) const;
  void UpdateBoost(double demand, double h, EngineState* s) const;
  void UpdateBrake(const EngineRequest& request, double available, double h, EngineState* s) const;
  double BrakeTorqueMax(double speed) const;
  void Synchronize(const EngineRequest& request, const EnginePoint& at, double h,
                   EngineState* s) const;

  double idle_speed_, governed_speed_, governor_droop_, reference_torque_, inertia_;
  double pedal_up_, pedal_fade_;
  double rise_rate_, rise_rate_low_, rise_threshold_;
  double fall_rate_, fall_rate_low_, fall_threshold_, cut_time_, boost_lag_, spool_time_;
  double idle_gain_, idle_integral_gain_, idle_band_, idle_integral_min_, idle_integral_max_;
  double idle_forget_time_;
  double sync_lag_, sync_torque_share_, sync_brake_share_;
  double brake_power_, brake_speed_, brake_exponent_, brake_speed_min_, brake_fade_;
  double brake_lag_, brake_release_lag_;
  double idle_fuel_rate_;
  Curve full_load_, drag_;
  UniformCurve brake_torque_;  // without the fading near idle
  Map pedal_map_, fuel_map_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_ENGINE_H_
