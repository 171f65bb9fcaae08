// What the shift strategy knows of the vehicle: acceleration and load, and what a change would lead
// to.

#include <algorithm>

#include "plugin/shift_strategy.h"

namespace iits {

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

// Shaft speed when a change that begins now is over: the load slows the vehicle down, a descent
// speeds it up.
double ShiftStrategy::SpeedAfterChange(const Situation& now) const {
  double coasting = -now.state.load / VehicleInertia(now);
  if (now.in.pedal > now.engine.pedal_up()) coasting = std::min(coasting, now.state.acceleration);
  return now.in.shaft_speed + change_time_ * coasting;
}

double ShiftStrategy::ShaftTorque(const Situation& now, int gear, double engine_torque) const {
  return engine_torque * now.gears.Ratio(gear) * now.gears.efficiency;
}

// Shaft speed that is left when the change to `next` is over and the engine's torque has built up
// to the load again.
double ShiftStrategy::SpeedWhenRecovered(const Situation& now, int next) const {
  const Engine& engine = now.engine;
  const double after = SpeedAfterChange(now);
  if (now.in.pedal <= engine.pedal_up()) {
    // Braked: the gear shall do for a while.
    return after + recovery_horizon_ * std::min(0.0, now.state.acceleration);
  }
  const double speed = now.gears.Ratio(next) * after;
  const double drag = engine.Drag(speed);
  const double transmission = ShaftTorque(now, next, 1);
  const double before = now.in.shaft_torque / ShaftTorque(now, now.gear, 1);
  const double demand = engine.PedalTorque(speed, now.in.pedal);
  const double level = std::max(0.0, now.state.load) / transmission;
  const double impulse = engine.RecoveryImpulse(before, change_time_, demand, level, drag);
  return after - impulse * transmission / VehicleInertia(now);
}

// The same for an upshift; 0 when the pedal's torque would never hold the load. A gear that failed
// under this load must show more torque and more speed.
double ShiftStrategy::SpeedAfterUpshift(const Situation& now, int next) const {
  const double load = std::max(0.0, now.state.load);
  const bool failed = now.state.failed_gear > 0 && next >= now.state.failed_gear;
  const double reserve = failed ? std::max(failed_reserve_, torque_reserve_) : torque_reserve_;
  const double speed = SpeedWhenRecovered(now, next);
  const double turns = now.gears.Ratio(next) * speed;
  const double margin = failed ? std::max(downshift_speed_, upshift_speed_) : upshift_speed_;
  if (turns < margin * LowSpeed(now.engine, now.in.pedal)) return 0;
  const double torque = now.engine.PedalTorque(turns, now.in.pedal);
  return ShaftTorque(now, next, torque) >= reserve * load ? speed : 0;
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
  const double recovered = SpeedWhenRecovered(now, gear);
  const double torque = ShaftTorque(now, gear, now.engine.TorqueLimit(ratio * recovered));
  const double acceleration = (torque - now.state.load) / VehicleInertia(now);
  return ratio * (recovered + reversal_time_ * acceleration) > now.engine.governed_speed();
}

}  // namespace iits
