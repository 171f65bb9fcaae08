// The "adaptive" strategy: grade and mass are in the load, the load decides.

#include <algorithm>
#include <cmath>

#include "plugin/config.h"
#include "plugin/shift_strategy.h"

namespace iits {

namespace {

// Step in time of a look ahead [s]: numerical.
constexpr double kLookStep = 0.5;

}  // namespace

// Power at the wheels [W] in a gear with the pedal on the floor.
double ShiftStrategy::AvailablePower(const Situation& now, int gear, double shaft_speed) const {
  double torque = now.engine.PedalTorque(now.gears.Ratio(gear) * shaft_speed, 1);
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

// Work at the wheels [J] within the horizon when the change to this gear begins now, under the
// present load: what the pause and the building-up of the torque cost is in it.
double ShiftStrategy::WorkAhead(const Situation& now, int gear) const {
  const Engine& engine = now.engine;
  const double from = now.in.shaft_speed, load = now.state.load, inertia = VehicleInertia(now);
  const double ratio = now.gears.Ratio(gear), transmission = ShaftTorque(now, gear, 1);
  const double before = now.in.shaft_torque / ShaftTorque(now, now.gear, 1);
  double speed = from, left = adaptive_horizon_, angle = 0;
  if (gear != now.gear) {
    speed = SpeedAfterChange(now, from);
    angle = 0.5 * (from + speed) * change_time_;
    left -= change_time_;
  }
  const double demand = engine.PedalTorque(ratio * speed, now.in.pedal);
  const double drag = engine.Drag(ratio * speed);
  const TorqueRecovery recovery = gear == now.gear
                                      ? engine.BuildUp(before, demand, demand, drag)
                                      : engine.Recovery(before, change_time_, demand, demand, drag);
  // Torque that is missing at first, spread over the time until it is there.
  const double missing = recovery.time > 0 ? recovery.impulse / recovery.time : 0;
  double building = recovery.time;
  while (left > 0 && speed > 0) {
    const double step = std::min(kLookStep, left);
    const double share = std::min(building, step) / step;
    const double torque = engine.PedalTorque(ratio * speed, now.in.pedal) - share * missing;
    const double next = std::max(0.0, speed + step * (torque * transmission - load) / inertia);
    angle += 0.5 * (speed + next) * step;
    speed = next;
    left -= step;
    building -= share * step;
  }
  return 0.5 * inertia * (speed * speed - from * from) + load * angle;
}

// Floored pedal: the gear that does the most work within the horizon, a higher one only when the
// engine turns as fast as it is meant to. The present one stays unless another does more by
// `adaptive_gain`.
int ShiftStrategy::StrongestGear(const Situation& now) const {
  const double speed = now.in.shaft_speed;
  const double fastest = downshift_speed_max_ * now.engine.governed_speed();
  const double kept = WorkAhead(now, now.gear);
  double most = kept + adaptive_gain_ * std::abs(kept);
  int best = now.gear;
  const int up = InputSpeed(now) < fastest ? 0 : skip_up_max_;
  const int lowest = std::max(start_gear_, now.gear - skip_down_max_);
  for (int gear = std::min(now.gears.count(), now.gear + up); gear >= lowest; --gear) {
    if (gear == now.gear) continue;
    if (gear > now.gear && SpeedAfterUpshift(now, gear) <= 0) continue;
    if (gear < now.gear) {
      if (now.gears.Ratio(gear) * speed > fastest || SoonOutgrown(now, gear)) break;
      if (!Bears(now, gear, DipOf(now, gear, speed))) continue;
    }
    const double work = WorkAhead(now, gear);
    if (work > most) {
      most = work;
      best = gear;
    }
  }
  return best;
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
  // Floored and not enough: all that there is. Fuel decides only on shifting up.
  const bool floored = now.in.pedal >= kick_down_pedal_;
  if (floored && !able) {
    const int strongest = StrongestGear(now);
    if (strongest != now.gear) return strongest;
  }
  double least = able ? (1 - adaptive_gain_) * FuelFor(now, now.gear, speed, wanted) : kInfinity;
  // Near its governor the present gear gives less than is wanted: another one need not give more.
  double kept = std::min(wanted, AvailablePower(now, now.gear, speed));
  int best = now.gear;
  int lowest = floored ? now.gear : std::max(start_gear_, now.gear - skip_down_max_);
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
