#include "plugin/shift_strategy.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "plugin/config.h"

namespace iits {

bool ShiftStrategy::Read(const mjModel* m, int instance, int gear_count, double change_time) {
  change_time_ = change_time;
  double start_gear, skip_up, skip_down;
  const Attribute attributes[] = {
      {"start_gear", 1, static_cast<double>(gear_count), &start_gear},
      {"downshift_delay", 0, 10, &downshift_delay_},
      {"downshift_margin", 0, 20, &downshift_margin_},
      {"min_gear_time", 0, 20, &min_gear_time_},
      {"reversal_time", 0, 60, &reversal_time_},
      {"acceleration_lag", 0.001, 10, &acceleration_lag_},
      {"load_lag", 0.001, 10, &load_lag_},
      {"pedal_lag", 0.001, 20, &pedal_lag_},
      {"lowest_speed", 1, 3, &lowest_speed_},
      {"lowest_speed_pedal", 0, 3, &lowest_speed_pedal_},
      {"rolling_speed", 1, 4, &rolling_speed_},
      {"recovery_horizon", 0, 10, &recovery_horizon_},
      {"recovery_speed", 0.5, 3, &recovery_speed_},
      {"recovery_time", 0, 10, &recovery_time_},
      {"upshift_speed_margin", 1, 2, &upshift_speed_},
      {"downshift_speed_margin", 1, 2, &downshift_speed_},
      {"downshift_speed_max", 0.1, 1, &downshift_speed_max_},
      {"power_speed", 1, 5, &power_speed_},
      {"overspeed", 1, 2, &overspeed_},
      {"overspeed_braking", 1, 2, &overspeed_braking_},
      {"torque_reserve", 1, 3, &torque_reserve_},
      {"failed_reserve", 1, 3, &failed_reserve_},
      {"failed_load", 0, 1, &failed_load_},
      {"built_up_torque", 0, 1, &built_up_torque_},
      {"stuck_acceleration", 0, 5, &stuck_acceleration_},
      {"first_gear_delay", 0, 20, &first_gear_delay_},
      {"engage_speed_max", 0, 20, &engage_speed_max_},
      {"floored_pedal", 0.1, 1, &floored_pedal_},
      {"kick_down_pedal", 0.1, 1, &kick_down_pedal_},
      {"kick_down_rise", 0, 1, &kick_down_rise_},
      {"kick_down_speed", 0.1, 1, &kick_down_speed_},
      {"skip_up_max", 1, 32, &skip_up},
      {"skip_down_max", 1, 32, &skip_down},
      {"braking_speed_low", 0.1, 1, &braking_speed_low_},
      {"braking_speed_high", 0.1, 1, &braking_speed_high_},
      {"braking_deceleration", 0, 20, &braking_deceleration_},
      {"adaptive_period", 0, 5, &adaptive_period_},
      {"adaptive_reserve", 1, 3, &adaptive_reserve_},
      {"adaptive_gain", 0, 1, &adaptive_gain_},
      {"adaptive_speed_max", 0.1, 1, &adaptive_speed_max_},
      {"adaptive_horizon", 1, 120, &adaptive_horizon_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  start_gear_ = static_cast<int>(start_gear);
  skip_up_max_ = static_cast<int>(skip_up);
  skip_down_max_ = static_cast<int>(skip_down);
  const char* text = mj_getPluginConfig(m, instance, "shift_strategy");
  std::string strategy = text ? text : "";
  adaptive_ = strategy == "adaptive";
  if (!adaptive_ && strategy != "tables") {
    mju_warning("plugin instance '%s': shift_strategy '%s' is not one of tables, adaptive",
                InstanceName(m, instance).c_str(), strategy.c_str());
    return false;
  }
  return ReadMap(m, instance, "upshift_gear", "upshift_pedal", "upshift_speed", 0, 200,
                 &upshift_) &&
         ReadMap(m, instance, "downshift_gear", "downshift_pedal", "downshift_speed", 0, 200,
                 &downshift_);
}

int ShiftStrategy::GearForSpeed(const Gears& gears, const Engine& engine,
                                double shaft_speed) const {
  for (int gear = gears.count(); gear > start_gear_; --gear) {
    if (gears.Ratio(gear) * shaft_speed >= rolling_speed_ * engine.idle_speed()) return gear;
  }
  return start_gear_;
}

bool ShiftStrategy::Fits(const Gears& gears, const Engine& engine, int gear,
                         double shaft_speed) const {
  double speed = gears.Ratio(gear) * shaft_speed;
  return (gear <= start_gear_ || speed > engine.idle_speed()) &&
         (gear == gears.count() || speed < overspeed_ * engine.brake_speed());
}

// Driven beyond what the governor, or the engine brake, is made for.
bool ShiftStrategy::TooFast(const Situation& now) const {
  double limit = overspeed_ * now.engine.governed_speed();
  if (Braking(now)) limit = overspeed_braking_ * now.engine.brake_speed();
  return InputSpeed(now) > limit;
}

// Up again soon after a downshift: only when the engine runs against its governor. Down again soon
// after an upshift: only for a kick-down.
bool ShiftStrategy::ReversesTooSoon(const Situation& now, int next) const {
  if (now.state.direction * (next - now.gear) >= 0 || now.state.gear_time > reversal_time_) {
    return false;
  }
  if (next < now.gear) return !KicksDown(now.in, now.state);
  return InputSpeed(now) < downshift_speed_max_ * now.engine.governed_speed();
}

// Highest gear that the table allows and that holds.
int ShiftStrategy::TableUpshift(const Situation& now) const {
  int best = now.gear;
  int highest = std::min(now.gears.count(), now.gear + skip_up_max_);
  for (int next = now.gear + 1; next <= highest; ++next) {
    if (now.gears.Speed(now.in.shaft_speed) < upshift_(next - 1, now.in.pedal)) break;
    if (SpeedAfterUpshift(now, next) > 0) best = next;
  }
  return best;
}

// Floored pedal, the engine gives what it has, that is less than the load, and the lower gear has
// more.
bool ShiftStrategy::LosesSpeed(const Situation& now) const {
  double speed = InputSpeed(now);
  if (now.in.pedal <= floored_pedal_ || SpeedSoon(now) > power_speed_ * now.engine.idle_speed())
    return false;
  double full = ShaftTorque(now, now.gear, now.engine.PedalTorque(speed, now.in.pedal));
  if (!GivesItsTorque(now) || full > now.state.load) return false;
  double faster = now.gears.Ratio(now.gear - 1) * now.in.shaft_speed;
  double lower = ShaftTorque(now, now.gear - 1, now.engine.PedalTorque(faster, now.in.pedal));
  return lower > torque_reserve_ * full;
}

bool ShiftStrategy::CallsForLower(const Situation& now) const {
  if (now.gear < 2) return false;
  if (BrakeGear(now) != now.gear) return true;
  double low = LowSpeed(now.engine, now.in.pedal);
  if (now.gear <= start_gear_) {
    return now.in.pedal > floored_pedal_ && InputSpeed(now) < low && GivesItsTorque(now) &&
           now.gears.Speed(now.state.acceleration) < stuck_acceleration_;
  }
  // Too slow, and not recovering.
  double soon = SpeedSoon(now);
  if (std::max(InputSpeed(now), soon) < low && !Recovers(now)) return true;
  if (WaitingCosts(now)) return true;
  if (!adaptive_ && now.gears.Speed(now.in.shaft_speed) <
                        downshift_(now.gear, now.in.pedal) - downshift_margin_) {
    return true;
  }
  return LosesSpeed(now);
}

double ShiftStrategy::LowTime(const Situation& now, double h) const {
  return CallsForLower(now) ? now.state.low_time + h : 0;
}

// Lower gear whose engine speed will be comfortable when the change is over.
int ShiftStrategy::Downshift(const Situation& now) const {
  double ceiling = downshift_speed_max_ * now.engine.governed_speed();
  double after = SpeedAfterChange(now, now.in.shaft_speed);
  double wanted = downshift_speed_ * LowSpeed(now.engine, now.in.pedal);
  int lowest = now.in.pedal > floored_pedal_ ? 1 : start_gear_;
  int next = now.gear;
  while (next > lowest && now.gears.Ratio(next - 1) * after < ceiling) {
    double recovered = next < now.gear ? SpeedWhenRecovered(now, next, now.in.shaft_speed) : 0;
    if (next < now.gear &&
        (now.gears.Ratio(next) * recovered >= wanted || SoonOutgrown(now, next - 1))) {
      break;
    }
    --next;
  }
  if (now.in.pedal <= floored_pedal_ || next == now.gear) return next;
  // Every change costs speed: at once into the gear that will hold.
  const Held best = BestHeld(now, now.in.shaft_speed);
  if (best.speed > 0 && (WaitingCosts(now) || HeldSpeed(now, next, now.in.shaft_speed) <= 0)) {
    return best.gear;
  }
  return next;
}

// The pedal has just been floored: into the gear that the upshift table would still be in.
int ShiftStrategy::KickDown(const Situation& now) const {
  const GearboxInput& in = now.in;
  if (!KicksDown(in, now.state)) return now.gear;
  double ceiling = downshift_speed_max_ * now.engine.governed_speed();
  double speed = now.gears.Speed(in.shaft_speed);
  int next = now.gear;
  while (next > start_gear_ && now.gear - next < skip_down_max_ &&
         now.gears.Ratio(next - 1) * in.shaft_speed < ceiling &&
         speed < kick_down_speed_ * upshift_(next - 1, in.pedal) && !SoonOutgrown(now, next - 1)) {
    --next;
  }
  return next;
}

// The more engine brake the driver asks for, the faster the engine shall turn; friction brakes that
// slow the truck down anyway need no help.
int ShiftStrategy::BrakeGear(const Situation& now) const {
  if (!Braking(now) || now.in.driver_engine_brake <= 0 ||
      now.gears.Speed(now.state.acceleration) < -braking_deceleration_) {
    return now.gear;
  }
  double share = braking_speed_low_ + (braking_speed_high_ - braking_speed_low_) *
                                          std::min(1.0, now.in.driver_engine_brake);
  double limit = share * now.engine.brake_speed();
  double fastest = std::max(now.in.shaft_speed, SpeedAfterChange(now, now.in.shaft_speed));
  int next = now.gear;
  while (next > start_gear_ && now.gear - next < skip_down_max_ &&
         now.gears.Ratio(next - 1) * fastest < limit) {
    --next;
  }
  return next;
}

ShiftStrategy::Choice ShiftStrategy::Choose(const Situation& now, double h) const {
  const int gear = now.gear;
  const GearboxState& s = now.state;
  bool standing = now.gears.Ratio(start_gear_) * now.in.shaft_speed < now.engine.idle_speed();
  if (standing && now.in.clutch_open &&
      (gear > start_gear_ || now.in.pedal < now.engine.pedal_up())) {
    return {start_gear_, false};
  }
  if (gear < now.gears.count() && TooFast(now)) return {gear + 1, false};
  if (s.gear_time < min_gear_time_) return {gear, false};
  bool decides = !adaptive_ || std::floor(s.gear_time / adaptive_period_) !=
                                   std::floor((s.gear_time - h) / adaptive_period_);
  bool cut = now.in.pedal < now.in.driver_pedal;  // by the brakes: it will come back
  if (now.in.pedal > now.engine.pedal_up() && decides && !cut) {
    int next = adaptive_ ? AdaptiveGear(now) : TableUpshift(now);
    if (next == gear && !adaptive_) next = KickDown(now);
    if (next != gear && !ReversesTooSoon(now, next)) return {next, false};
  }
  double delay = downshift_delay_ + (gear <= start_gear_ ? first_gear_delay_ : 0);
  if (s.low_time <= delay) return {gear, false};
  int lower = BrakeGear(now);
  if (lower == gear) lower = Downshift(now);
  return {lower, lower != gear && now.in.pedal > now.engine.pedal_up()};
}

}  // namespace iits
