// Decisions of the automated gearbox: time and target of a gear change.
#ifndef IITS_MJ_PLUGIN_LAWS_SHIFT_STRATEGY_H_
#define IITS_MJ_PLUGIN_LAWS_SHIFT_STRATEGY_H_

#include "plugin/laws/shift_adaptive.h"
#include "plugin/laws/shift_prediction.h"

namespace iits {

// Two strategies. "tables": published shift speeds over the pedal, unless engine speed or torque
// forbid the change. "adaptive": by load and mass, the gear with the lowest fuel rate for the
// requested power, among those with a torque reserve.
template <class T>
struct ShiftStrategy : ShiftParameters<T> {
  using Situation = ShiftSituation<T>;
  struct Choice {
    int gear;
    bool failed;  // the gear could not carry the load
  };

  // Duration of the present demand for a lower gear [s].
  static T LowTime(const Situation& now, T h) {
    return CallsForLower(now) ? now.state.low_time + h : T(0);
  }

  // Gear to engage in drive.
  static Choice Choose(const Situation& now, T h) {
    const ShiftParameters<T>& p = now.p;
    const int gear = now.gear;
    const GearboxState<T>& s = now.state;
    const T pedal_up = now.engine.pedal_up;
    const bool standing =
        now.gears.Ratio(p.start_gear) * now.in.shaft_speed < now.engine.idle_speed &&
        !now.Recovers();
    if (standing && now.in.clutch_open && (gear > p.start_gear || now.in.pedal < pedal_up)) {
      return {p.start_gear, gear > p.start_gear && now.Floored()};
    }
    if (gear < now.gears.count() && TooFast(now)) return {gear + 1, false};
    if (s.gear_time < p.min_gear_time && !(s.direction < 0 && now.LosesClimb()))
      return {gear, false};
    const bool decides = !p.adaptive || floor(s.gear_time / p.adaptive_period) !=
                                            floor((s.gear_time - h) / p.adaptive_period);
    if (now.in.pedal > pedal_up && decides && !TorqueIsCut(now)) {
      int next = p.adaptive ? AdaptiveGear(now) : TableUpshift(now);
      if (next == gear && !p.adaptive) next = KickDown(now);
      if (next != gear && !ReversesTooSoon(now, next)) return {next, false};
    }
    const T delay = p.downshift_delay + (gear <= p.start_gear ? p.first_gear_delay : T(0));
    if (s.low_time <= delay) return {gear, false};
    int lower = BrakeGear(now);
    if (lower == gear) lower = Downshift(now);
    return {lower, lower != gear && now.in.pedal > pedal_up};
  }

  // Whether in the requested gear the engine turns above its lowest speed with the pedal released,
  // and below the governor's limit.
  static bool Grants(const Situation& now) {
    const int wanted = now.in.requested_gear;
    if (wanted < 1 || wanted > now.gears.count()) return false;
    const T speed = now.gears.Ratio(wanted) * now.in.shaft_speed;
    return speed > now.p.LowSpeed(now.engine, 0) &&
           speed < now.p.overspeed * now.engine.governed_speed;
  }

  // The requested gear, once the present one has been engaged for its least time.
  static Choice Requested(const Situation& now) {
    const bool may_change = now.state.gear_time >= now.p.min_gear_time;
    return {may_change ? now.in.requested_gear : now.gear, false};
  }

  // Gear to engage in a downshift under way: the load may rise meanwhile, as on the foot of a
  // climb. Then it is the lower gear that still holds the load. Where a change costs little, the
  // gear stays: the wheels' slip vanishes with the torque, and that looks like a load.
  static int Correct(const Situation& now) {
    const T from = now.in.shaft_speed;
    const T lost = -now.p.change_time * now.state.acceleration;
    if (!now.Floored() || !now.CostlyChange(lost, Situation::kCorrectedChange)) return now.gear;
    const typename Situation::Outcome outcome = now.After(now.gear, from);
    if (outcome.uptake == Situation::kTurns) return now.gear;
    const auto best = now.BestDescent(from);
    return best.from >= from && best.outcome > outcome ? best.gear : now.gear;
  }

 private:
  // Whether brakes or traction control take torque away temporarily. While the governor limits the
  // torque, a cut of the accelerator takes none.
  static bool TorqueIsCut(const Situation& now) {
    if (now.in.pedal >= now.in.driver_pedal) return false;
    const T limit = now.engine.TorqueLimit(now.InputSpeed());
    return now.engine.pedal_map(now.InputSpeed(), now.in.pedal) < limit;
  }

  // Whether the engine exceeds the limit of the governor, or of the engine brake.
  static bool TooFast(const Situation& now) {
    T limit = now.p.overspeed * now.engine.governed_speed;
    if (now.Braking()) limit = now.p.overspeed_braking * now.engine.brake_speed;
    return now.InputSpeed() > limit;
  }

  // An upshift soon after a downshift requires an engine at its governor; a downshift soon after an
  // upshift requires a kick-down.
  static bool ReversesTooSoon(const Situation& now, int next) {
    if (now.state.direction * (next - now.gear) >= 0 || now.state.gear_time > now.p.reversal_time) {
      return false;
    }
    return next < now.gear ? !now.KicksDown() : now.InputSpeed() < now.Ceiling();
  }

  // Highest gear that the table allows and that holds the load.
  static int TableUpshift(const Situation& now) {
    if (now.Floored() && now.LoadRises()) return now.gear;
    int best = now.gear;
    const int highest = Min(now.gears.count(), now.gear + now.p.skip_up_max);
    for (int next = now.gear + 1; next <= highest; ++next) {
      if (now.gears.Speed(now.in.shaft_speed) < now.p.upshift(T(next - 1), now.in.pedal)) break;
      if (now.SpeedAfterUpshift(next) > 0) best = next;
    }
    return best;
  }

  // Whether, with a floored pedal, the engine's full torque is less than the load, and a lower gear
  // holds a clearly higher speed or, for a slow engine, has more torque.
  static bool LosesSpeed(const Situation& now) {
    const T speed = now.InputSpeed();
    if (!now.Floored() || now.Recovers()) return false;
    const T full = now.ShaftTorque(now.gear, now.engine.PedalTorque(speed, now.in.pedal), speed);
    if (!now.TorqueHasBuiltUp() || full > now.state.load || now.LoadRises()) return false;
    if (now.SpeedSoon() > now.p.power_speed * now.engine.idle_speed) {
      const T speed = now.p.failed_reserve * now.in.shaft_speed;
      const auto best = now.BestDescent(now.in.shaft_speed);
      return best.from >= now.in.shaft_speed &&
             best.outcome > typename Situation::Outcome{Situation::kTurns, speed};
    }
    const T faster = now.gears.Ratio(now.gear - 1) * now.in.shaft_speed;
    const T torque = now.engine.PedalTorque(faster, now.in.pedal);
    const T lower = now.ShaftTorque(now.gear - 1, torque, faster);
    return lower > now.p.torque_reserve * full;
  }

  static bool CallsForLower(const Situation& now) {
    const ShiftParameters<T>& p = now.p;
    if (now.gear < 2) return false;
    if (BrakeGear(now) != now.gear) return true;
    const T low = now.LowSpeed();
    if (now.gear <= p.start_gear) {
      return now.Floored() && now.InputSpeed() < low && now.TorqueHasBuiltUp() &&
             now.gears.Speed(now.state.acceleration) < p.stuck_acceleration;
    }
    // Too slow, and not recovering.
    if (Max(now.InputSpeed(), now.SpeedSoon()) < low && !now.Recovers()) return true;
    if (now.WaitingCosts()) return true;
    if (!p.adaptive && now.gears.Speed(now.in.shaft_speed) <
                           p.downshift(T(now.gear), now.in.pedal) - p.downshift_margin) {
      return true;
    }
    return LosesSpeed(now);
  }

  // Lower gear with a sufficient engine speed after the change.
  static int Downshift(const Situation& now) {
    const T after = now.SpeedAfterChange(now.in.shaft_speed);
    const T wanted = now.p.downshift_speed * now.LowSpeed();
    const int lowest = now.Floored() ? 1 : now.p.start_gear;
    int next = now.gear;
    while (next > lowest && now.gears.Ratio(next - 1) * after < now.Ceiling()) {
      if (next < now.gear && (now.gears.Ratio(next) * now.SpeedWhenRecovered(next) >= wanted ||
                              now.SoonOutgrown(next - 1))) {
        break;
      }
      --next;
    }
    if (!now.Floored() || next == now.gear) return next;
    // Every change costs speed: directly into the gear that will hold the load.
    const bool turns = now.After(next, now.in.shaft_speed).uptake == Situation::kTurns;
    if (turns && !now.WaitingCosts()) return next;
    const auto best = now.BestDescentAfter(0);
    return best.from < now.in.shaft_speed ? now.gear : best.gear;
  }

  // The pedal has just been floored: the gear in which the upshift table would still be.
  static int KickDown(const Situation& now) {
    if (!now.KicksDown()) return now.gear;
    const T speed = now.gears.Speed(now.in.shaft_speed);
    int next = now.gear;
    while (next > now.p.start_gear && now.gear - next < now.p.skip_down_max &&
           now.gears.Ratio(next - 1) * now.in.shaft_speed < now.Ceiling() &&
           speed < now.p.kick_down_speed * now.p.upshift(T(next - 1), now.in.pedal) &&
           !now.SoonOutgrown(next - 1)) {
      --next;
    }
    return next;
  }

  // The engine speed increases with the demanded engine brake; no downshift while friction brakes
  // already decelerate the truck.
  static int BrakeGear(const Situation& now) {
    const ShiftParameters<T>& p = now.p;
    if (!now.Braking() || now.in.driver_engine_brake <= 0 ||
        now.gears.Speed(now.state.acceleration) < -p.braking_deceleration) {
      return now.gear;
    }
    const T share = p.braking_speed_low + (p.braking_speed_high - p.braking_speed_low) *
                                              Min(1.0, now.in.driver_engine_brake);
    const T limit = share * now.engine.brake_speed;
    const T fastest = Max(now.in.shaft_speed, now.SpeedAfterChange(now.in.shaft_speed));
    int next = now.gear;
    while (next > p.start_gear && now.gear - next < p.skip_down_max &&
           now.gears.Ratio(next - 1) * fastest < limit) {
      --next;
    }
    return next;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_SHIFT_STRATEGY_H_
