// When the automated gearbox changes gear, and into which one.
#ifndef IITS_MJ_PLUGIN_SHIFT_STRATEGY_H_
#define IITS_MJ_PLUGIN_SHIFT_STRATEGY_H_

#include <mujoco/mujoco.h>

#include "plugin/engine.h"
#include "plugin/gears.h"
#include "plugin/lookup.h"

namespace iits {

// Two strategies. "tables": the published shift speeds over pedal say when to shift, engine speed
// and torque say when not to. "adaptive": by load and mass, the gear with the lowest fuel rate for
// the power that is asked for, among those that keep a torque reserve.
class ShiftStrategy {
 public:
  // Everything that a choice rests on.
  struct Situation {
    const Gears& gears;
    const Engine& engine;
    const GearboxInput& in;
    const GearboxState& state;
    int gear;  // engaged, 1 to n
  };
  struct Choice {
    int gear;
    bool failed;  // the gear could not carry the load
  };

  // Reads the attributes; false after a warning. `change_time`: of a gear change [s].
  bool Read(const mjModel* m, int instance, int gear_count, double change_time);

  // Gear for a vehicle that is found rolling at this speed.
  int GearForSpeed(const Gears& gears, const Engine& engine, double shaft_speed) const;
  // Speed, acceleration, load and pedal as the strategy sees them, after one more step.
  void Observe(const Gears& gears, const GearboxInput& in, double h, GearboxState* s) const;
  // For how long a lower gear has been called for [s].
  double LowTime(const Situation& now, double h) const;
  // Gear to be in, in drive.
  Choice Choose(const Situation& now, double h) const;
  // Whether a gear that is about to go in still fits the speed.
  bool Fits(const Gears& gears, const Engine& engine, int gear, double shaft_speed) const;

  // Lowest engine speed that the controller accepts in gear; higher with the pedal down.
  double LowSpeed(const Engine& engine, double pedal) const;
  double engage_speed_max() const { return engage_speed_max_; }

 private:
  // Of the shaft's speed [rad/s] in a change: when the clutch is closed, and at the lowest, a time
  // [s] later.
  struct Dip {
    double after, speed, time;
  };
  struct Held {
    int gear;
    double speed;  // of the shaft [rad/s], 0 when no gear holds the load
  };
  static bool Braking(const Situation& now) {
    return now.in.engine_brake > 0 && now.in.pedal < now.engine.pedal_up();
  }
  bool KicksDown(const GearboxInput& in, const GearboxState& s) const {
    return in.pedal >= kick_down_pedal_ && in.driver_pedal - s.pedal > kick_down_rise_;
  }
  static double VehicleInertia(const Situation& now) {
    return now.gears.VehicleInertia(now.in.mass);
  }
  double InputSpeed(const Situation& now) const;
  double SpeedSoon(const Situation& now) const;
  double SpeedAfterChange(const Situation& now, double from) const;
  double ShaftTorque(const Situation& now, int gear, double engine_torque) const;
  bool CallsForLower(const Situation& now) const;
  bool GivesItsTorque(const Situation& now) const;
  bool LosesSpeed(const Situation& now) const;
  Dip DipOf(const Situation& now, int next, double from) const;
  double SpeedWhenRecovered(const Situation& now, int next, double from) const {
    return DipOf(now, next, from).speed;
  }
  bool Bears(const Situation& now, int gear, const Dip& dip) const;
  bool Carries(const Situation& now, int gear, double shaft_speed, double reserve) const;
  double HeldSpeed(const Situation& now, int gear, double from) const;
  Held BestHeld(const Situation& now, double from) const;
  bool WaitingCosts(const Situation& now) const;
  bool Recovers(const Situation& now) const;
  double SpeedAfterUpshift(const Situation& now, int next) const;
  bool SoonOutgrown(const Situation& now, int gear) const;
  bool TooFast(const Situation& now) const;
  bool ReversesTooSoon(const Situation& now, int next) const;
  int TableUpshift(const Situation& now) const;
  int KickDown(const Situation& now) const;
  int BrakeGear(const Situation& now) const;
  int Downshift(const Situation& now) const;
  // shift_adaptive.cc
  int AdaptiveGear(const Situation& now) const;
  double PowerWanted(const Situation& now) const;
  double FuelFor(const Situation& now, int gear, double shaft_speed, double power) const;
  double AvailablePower(const Situation& now, int gear, double shaft_speed) const;
  double WorkAhead(const Situation& now, int gear) const;
  int StrongestGear(const Situation& now) const;

  bool adaptive_;
  int start_gear_, skip_up_max_, skip_down_max_;
  double change_time_, downshift_delay_, downshift_margin_, min_gear_time_, reversal_time_;
  double acceleration_lag_, load_lag_, pedal_lag_;
  double lowest_speed_, lowest_speed_pedal_, rolling_speed_, recovery_horizon_, recovery_speed_,
      recovery_time_;
  double upshift_speed_, downshift_speed_, downshift_speed_max_, power_speed_;
  double overspeed_, overspeed_braking_;
  double torque_reserve_, failed_reserve_, failed_load_, built_up_torque_;
  double stuck_acceleration_, first_gear_delay_, engage_speed_max_;
  double floored_pedal_, kick_down_pedal_, kick_down_rise_, kick_down_speed_;
  double braking_speed_low_, braking_speed_high_, braking_deceleration_;
  double adaptive_period_, adaptive_reserve_, adaptive_gain_, adaptive_speed_max_,
      adaptive_horizon_;
  Map upshift_, downshift_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_SHIFT_STRATEGY_H_
