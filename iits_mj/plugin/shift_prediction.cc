// What the shift strategy knows of the vehicle: acceleration and load, and what a change would lead
// to.

#include <algorithm>
#include <cmath>

#include "plugin/shift_strategy.h"

namespace iits {
namespace {

// Step of a search for the speed that a gear holds, as a share of the governed speed: numerical.
constexpr double kHeldSpeedStep = 0.01;

}  // namespace

// Shaft speed is low-passed once; its distance to the raw speed is the filtered acceleration.
// Load: torque that would hold the speed, by the balance T = load + I dw/dt of the vehicle's mass,
// all with the same lag.
void ShiftStrategy::Observe(const Gears& gears, const GearboxInput& in, double h,
                            GearboxState* s) const {
  double difference = in.shaft_speed - s->shaft_speed;
  s->shaft_speed += difference * h / (acceleration_lag_ + h);
  s->acceleration = difference / (acceleration_lag_ + h);
  s->torque += (in.shaft_torque - s->torque) * h / (acceleration_lag_ + h);
  double load = s->torque - gears.VehicleInertia(in.mass) * s->acceleration;
  s->load += (load - s->load) * h / (load_lag_ + h);
  s->pedal += (in.driver_pedal - s->pedal) * h / (pedal_lag_ + h);
  if (s->load < failed_load_ * s->failed_load) s->failed_gear = s->failed_load = 0;
}

double ShiftStrategy::LowSpeed(const Engine& engine, double pedal) const {
  return engine.idle_speed() * (lowest_speed_ + lowest_speed_pedal_ * pedal);
}

double ShiftStrategy::InputSpeed(const Situation& now) const {
  return now.gears.Ratio(now.gear) * now.in.shaft_speed;
}

// Gearbox input speed a little later, if the gear stays.
double ShiftStrategy::SpeedSoon(const Situation& now) const {
  double speed = now.in.shaft_speed + recovery_horizon_ * now.state.acceleration;
  return now.gears.Ratio(now.gear) * speed;
}

// Shaft speed when a change that begins at `from` is over: the load slows the vehicle down, a
// descent speeds it up.
double ShiftStrategy::SpeedAfterChange(const Situation& now, double from) const {
  double coasting = -now.state.load / VehicleInertia(now);
  if (now.in.pedal > now.engine.pedal_up()) coasting = std::min(coasting, now.state.acceleration);
  return from + change_time_ * coasting;
}

double ShiftStrategy::ShaftTorque(const Situation& now, int gear, double engine_torque) const {
  return engine_torque * now.gears.Ratio(gear) * now.gears.efficiency;
}

// How the shaft's speed falls by a change to `next` that begins at `from`, and further until the
// engine's torque has built up to the load; for the present gear, only the latter.
ShiftStrategy::Dip ShiftStrategy::DipOf(const Situation& now, int next, double from) const {
  const Engine& engine = now.engine;
  const double after = next == now.gear ? from : SpeedAfterChange(now, from);
  if (now.in.pedal <= engine.pedal_up()) {
    // Braked: the gear shall do for a while.
    return {after, after + recovery_horizon_ * std::min(0.0, now.state.acceleration), 0};
  }
  const double speed = now.gears.Ratio(next) * after;
  const double drag = engine.Drag(speed);
  const double transmission = ShaftTorque(now, next, 1);
  const double before = now.in.shaft_torque / ShaftTorque(now, now.gear, 1);
  const double demand = engine.PedalTorque(speed, now.in.pedal);
  const double level = std::max(0.0, now.state.load) / transmission;
  const TorqueRecovery recovery = next == now.gear
                                      ? engine.BuildUp(before, demand, level, drag)
                                      : engine.Recovery(before, change_time_, demand, level, drag);
  const double lost = recovery.impulse * transmission / VehicleInertia(now);
  return {after, after - lost, recovery.time};
}

// The engine does not turn too slowly while its torque builds up, and not slowly for long: with a
// floored pedal `recovery_speed` is accepted, below the slowest speed for `recovery_time`. As the
// deficit of torque fades in a straight line, speed goes down to the dip in a parabola.
bool ShiftStrategy::Bears(const Situation& now, int gear, const Dip& dip) const {
  const double ratio = now.gears.Ratio(gear), lowest = ratio * dip.speed;
  const double slow = LowSpeed(now.engine, now.in.pedal), low = upshift_speed_ * slow;
  if (lowest >= low) return true;
  if (now.in.pedal <= floored_pedal_ || lowest < recovery_speed_ * now.engine.idle_speed()) {
    return false;
  }
  if (lowest >= slow) return true;
  const double first = ratio * dip.after;
  const double share = first > slow ? std::sqrt((slow - lowest) / (first - lowest)) : 1;
  return share * dip.time <= recovery_time_;
}

// Torque over load is at least `reserve` at this shaft speed.
bool ShiftStrategy::Carries(const Situation& now, int gear, double shaft_speed,
                            double reserve) const {
  double torque = now.engine.PedalTorque(now.gears.Ratio(gear) * shaft_speed, now.in.pedal);
  return ShaftTorque(now, gear, torque) >= reserve * std::max(0.0, now.state.load);
}

// Shaft speed up to which a gear carries the load after a change to it that begins at `from`; 0
// when it never will.
double ShiftStrategy::HeldSpeed(const Situation& now, int gear, double from) const {
  const Dip dip = DipOf(now, gear, from);
  if (!Bears(now, gear, dip) || !Carries(now, gear, dip.speed, torque_reserve_)) return 0;
  const double ratio = now.gears.Ratio(gear);
  const double step = kHeldSpeedStep * now.engine.governed_speed() / ratio;
  double held = dip.speed;
  while (ratio * held < now.engine.governed_speed() && Carries(now, gear, held + step, 1)) {
    held += step;
  }
  return held;
}

// Lower gear that holds the highest speed on this climb, when the change begins at `from`.
ShiftStrategy::Held ShiftStrategy::BestHeld(const Situation& now, double from) const {
  const double ceiling = downshift_speed_max_ * now.engine.governed_speed();
  const double after = SpeedAfterChange(now, from);
  Held best = {now.gear, 0};
  for (int gear = now.gear - 1; gear >= start_gear_ && now.gears.Ratio(gear) * after < ceiling;
       --gear) {
    double held = HeldSpeed(now, gear, from);
    if (held > best.speed) best = {gear, held};
  }
  return best;
}

// Floored pedal: the torque, once it has built up, will carry the load before the engine is too
// slow.
bool ShiftStrategy::Recovers(const Situation& now) const {
  if (now.in.pedal <= floored_pedal_) return false;
  const Dip dip = DipOf(now, now.gear, now.in.shaft_speed);
  return Bears(now, now.gear, dip) && Carries(now, now.gear, dip.speed, torque_reserve_);
}

// Floored pedal, and the present gear does not hold at any speed: a lower one that holds now will
// not hold a little later.
bool ShiftStrategy::WaitingCosts(const Situation& now) const {
  if (now.in.pedal <= floored_pedal_ || now.state.acceleration >= 0 || Recovers(now)) return false;
  const double ratio = now.gears.Ratio(now.gear);
  const double step = kHeldSpeedStep * now.engine.governed_speed() / ratio;
  const double slowest = LowSpeed(now.engine, now.in.pedal) / ratio;
  double speed = SpeedWhenRecovered(now, now.gear, now.in.shaft_speed);
  for (; speed >= slowest; speed -= step) {
    if (Carries(now, now.gear, speed, 1)) return false;
  }
  const double held = BestHeld(now, now.in.shaft_speed).speed;
  if (held <= 0) return false;
  const double soon = now.in.shaft_speed + recovery_horizon_ * now.state.acceleration;
  return BestHeld(now, soon).speed < (1 - kHeldSpeedStep) * held;
}

// Shaft speed after an upshift, when the torque has built up; 0 when the pedal's torque would not
// hold the load then. A gear that failed under this load must show more torque.
double ShiftStrategy::SpeedAfterUpshift(const Situation& now, int next) const {
  const bool failed = now.state.failed_gear > 0 && next >= now.state.failed_gear;
  const double reserve = failed ? std::max(failed_reserve_, torque_reserve_) : torque_reserve_;
  const Dip dip = DipOf(now, next, now.in.shaft_speed);
  return Bears(now, next, dip) && Carries(now, next, dip.speed, reserve) ? dip.speed : 0;
}

// The torque at the wheels has built up to what the pedal asks for; while the clutch slips, at the
// engine's speed.
bool ShiftStrategy::GivesItsTorque(const Situation& now) const {
  double speed = std::max(InputSpeed(now), now.in.engine_speed);
  double full = ShaftTorque(now, now.gear, now.engine.PedalTorque(speed, now.in.pedal));
  return now.in.shaft_torque > built_up_torque_ * full;
}

// At full load the engine would reach its governed speed within the reversal time: not worth going
// down for.
bool ShiftStrategy::SoonOutgrown(const Situation& now, int gear) const {
  const double ratio = now.gears.Ratio(gear);
  const double recovered = SpeedWhenRecovered(now, gear, now.in.shaft_speed);
  const double torque = ShaftTorque(now, gear, now.engine.TorqueLimit(ratio * recovered));
  const double acceleration = (torque - now.state.load) / VehicleInertia(now);
  return ratio * (recovered + reversal_time_ * acceleration) > now.engine.governed_speed();
}

}  // namespace iits
