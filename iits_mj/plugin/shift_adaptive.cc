// The "adaptive" strategy: grade and mass are in the load, the load decides.

#include <algorithm>
#include <cmath>

#include "plugin/config.h"
#include "plugin/shift_strategy.h"

namespace iits {

// Greatest power at the wheels [W] in a gear.
double ShiftStrategy::AvailablePower(const Situation& now, int gear, double shaft_speed) const {
  double torque = now.engine.TorqueLimit(now.gears.Ratio(gear) * shaft_speed);
  return ShaftTorque(now, gear, torque) * shaft_speed;
}

// Power at the wheels [W] that the pedal asks for: that of the present gear, and with the pedal
// near the floor its share of what the best gear could give.
double ShiftStrategy::PowerWanted(const Situation& now) const {
  double speed = now.in.shaft_speed;
  double torque = now.engine.PedalTorque(InputSpeed(now), now.in.pedal);
  double wanted = ShaftTorque(now, now.gear, torque) * speed;
  if (now.in.pedal <= floored_pedal_) return wanted;
  double share = (now.in.pedal - floored_pedal_) / (1 - floored_pedal_);
  double ceiling = downshift_speed_max_ * now.engine.governed_speed();
  double greatest = 0;
  for (int gear = start_gear_; gear <= now.gears.count(); ++gear) {
    if (now.gears.Ratio(gear) * speed > ceiling) continue;
    greatest = std::max(greatest, AvailablePower(now, gear, speed));
  }
  return std::max(wanted, share * greatest / adaptive_reserve_);
}

// Fuel rate [kg/s] for this power at the wheels in a gear.
double ShiftStrategy::FuelFor(const Situation& now, int gear, double shaft_speed,
                              double power) const {
  const EnginePoint at = now.engine.At(now.gears.Ratio(gear) * shaft_speed);
  EngineState state = {};
  state.speed = at.speed;
  state.torque = power / (at.speed * now.gears.efficiency) + at.drag;
  return now.engine.FuelRate(at, state);
}

// The gear with the lowest fuel rate for the power wanted, among those that turn fast enough, not
// too fast, and keep a torque reserve over load and power. The present gear stays unless another
// one saves `adaptive_gain` of its fuel, or it cannot do it itself.
int ShiftStrategy::AdaptiveGear(const Situation& now) const {
  const Engine& engine = now.engine;
  const double speed = now.in.shaft_speed;
  const double load = std::max(0.0, now.state.load);
  const double wanted = std::max(0.0, PowerWanted(now));
  const double slowest = LowSpeed(engine, now.in.pedal);
  const double fastest = downshift_speed_max_ * engine.governed_speed();
  const double economic =
      fastest * (adaptive_speed_max_ + (1 - adaptive_speed_max_) * now.in.pedal);

  // The clutch slips or is open: nothing to compare.
  if (InputSpeed(now) < engine.idle_speed()) return now.gear;
  // The present gear may use its reserve up.
  double needed = std::max(wanted / adaptive_reserve_, load * speed);
  bool able = AvailablePower(now, now.gear, speed) >= needed && InputSpeed(now) < fastest;
  double least = able ? (1 - adaptive_gain_) * FuelFor(now, now.gear, speed, wanted) : kInfinity;
  // Near its governor the present gear gives less than is wanted: another one need not give more.
  double kept = std::min(wanted, AvailablePower(now, now.gear, speed));
  int best = now.gear;
  int lowest = std::max(start_gear_, now.gear - skip_down_max_);
  int highest = std::min(now.gears.count(), now.gear + skip_up_max_);
  for (int gear = lowest; gear <= highest; ++gear) {
    if (gear == now.gear || (gear < now.gear && SoonOutgrown(now, gear))) continue;
    double ratio = now.gears.Ratio(gear);
    if (ratio * speed > economic) continue;
    double after =
        gear > now.gear ? SpeedAfterUpshift(now, gear) : SpeedWhenRecovered(now, gear, speed);
    if (after <= 0 || (gear < now.gear && ratio * after < downshift_speed_ * slowest)) continue;
    if (AvailablePower(now, gear, after) < std::max(kept, adaptive_reserve_ * load * after)) {
      continue;
    }
    double fuel = FuelFor(now, gear, speed, wanted);
    if (fuel < least) {
      least = fuel;
      best = gear;
    }
  }
  return best;
}

}  // namespace iits
