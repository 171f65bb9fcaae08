// The gearbox controller's estimate of the vehicle's state, and its prediction of a gear change.
#ifndef IITS_MJ_PLUGIN_LAWS_SHIFT_PREDICTION_H_
#define IITS_MJ_PLUGIN_LAWS_SHIFT_PREDICTION_H_

#include "plugin/laws/engine.h"
#include "plugin/laws/gears.h"
#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"

namespace iits {

// Attributes of the shift strategy; ../README_powertrain.md explains each.
template <class T>
struct ShiftParameters {
  int start_gear, skip_up_max, skip_down_max;
  bool adaptive;            // else by tables
  T change_time, cut_time;  // of a gear change and of its first phase [s]
  T launch_range;  // engine speed above idle at which a launch carries the reference torque
  T downshift_delay, downshift_margin, min_gear_time, reversal_time;
  T acceleration_lag, load_lag, pedal_lag;
  T lowest_speed, lowest_speed_pedal, rolling_speed;
  T recovery_horizon, recovery_speed, recovery_time, relaunch_speed;
  T upshift_speed, downshift_speed, downshift_speed_max, power_speed;
  T overspeed, overspeed_braking;
  T torque_reserve, failed_reserve, failed_load, built_up_torque;
  T stuck_acceleration, first_gear_delay, engage_speed_max;
  T floored_pedal, kick_down_pedal, kick_down_rise, kick_down_speed;
  T braking_speed_low, braking_speed_high, braking_deceleration;
  T adaptive_period, adaptive_reserve, adaptive_gain, adaptive_speed_max, adaptive_horizon;
  T adaptive_time_price, adaptive_climb_speed;
  Map<T> upshift, downshift;

  // Advances the estimates of speed, acceleration, load and pedal. The shaft speed is low-passed
  // once; its difference to the raw speed gives the filtered acceleration. The load is the torque
  // at constant speed, from the balance T = load + I dw/dt of the vehicle's mass, with the same lag
  // in each term.
  void Observe(const Gears<T>& gears, const GearboxInput<T>& in, T h, GearboxState<T>* s) const {
    const T difference = in.shaft_speed - s->shaft_speed;
    s->shaft_speed += difference * h / (acceleration_lag + h);
    s->acceleration = difference / (acceleration_lag + h);
    s->torque += (in.shaft_torque - s->torque) * h / (acceleration_lag + h);
    const T load = s->torque - gears.VehicleInertia(in.mass) * s->acceleration;
    s->load += (load - s->load) * h / (load_lag + h);
    s->slow_load += (s->load - s->slow_load) * h / (recovery_horizon + h);
    s->pedal += (in.driver_pedal - s->pedal) * h / (pedal_lag + h);
    if (s->load < failed_load * s->failed_load) s->failed_gear = s->failed_load = 0;
  }

  // Lowest allowed engine speed in gear; it increases with the pedal.
  T LowSpeed(const Engine<T>& engine, T pedal) const {
    return engine.idle_speed * (lowest_speed + lowest_speed_pedal * pedal);
  }

  // Gear to engage at a speed in neutral.
  int GearForSpeed(const Gears<T>& gears, const Engine<T>& engine, T shaft_speed) const {
    for (int gear = gears.count(); gear > start_gear; --gear) {
      if (gears.Ratio(gear) * shaft_speed >= rolling_speed * engine.idle_speed) return gear;
    }
    return start_gear;
  }

  // Whether a gear to engage still fits the speed.
  bool Fits(const Gears<T>& gears, const Engine<T>& engine, int gear, T shaft_speed) const {
    const T speed = gears.Ratio(gear) * shaft_speed;
    return (gear <= start_gear || speed > engine.idle_speed) &&
           (gear == gears.count() || speed < overspeed * engine.brake_speed);
  }
};

// Inputs of the choice of a gear, and predictions from them. Speeds are those of the propeller
// shaft [rad/s] unless they are called engine speeds.
template <class T>
struct ShiftSituation {
  const ShiftParameters<T>& p;
  const Gears<T>& gears;
  const Engine<T>& engine;
  const GearboxInput<T>& in;
  const GearboxState<T>& state;
  int gear;  // engaged, 1 to n; in a change the gear to engage
  // Of a change that begins now: its length, and of that the cut [s]. Under way, what is left.
  T change_time = p.change_time, cut_time = p.cut_time;
  bool changing = false;  // in neutral, in a change

  // Numerical step of a search for the speed that a gear holds, as a share of the governed speed.
  static constexpr double kHeldSpeedStep = 0.01;
  // Share of the speed that a change costs, beyond which the gearbox looks ahead.
  static constexpr double kCostlyChange = 0.05;
  // The same share, beyond which it corrects a change under way.
  static constexpr double kCorrectedChange = 0.035;
  // Of `relaunch_speed`: an engaged gear saves a change.
  static constexpr double kEngagedShare = 0.6;

  // Shaft speed in a change: after the clutch has closed, and at its minimum, a time [s] later.
  struct Dip {
    T after, speed, time;
  };
  struct Held {
    int gear;
    T speed;  // 0 if no gear holds the load
  };
  // How a gear takes the load up again after a change.
  enum Uptake {
    kStops = 0,  // not at all, or so late that the truck stops
    kSlips,      // with a slipping clutch, as in a launch
    kTurns,      // with a closed clutch and an engine that is fast enough
  };
  // How a gear takes the load up, and the shaft speed that it then holds; if the truck stops, the
  // speed at the end of the dip.
  struct Outcome {
    Uptake uptake;
    T speed;
    bool operator>(const Outcome& other) const {
      return uptake != other.uptake ? uptake > other.uptake : speed > other.speed;
    }
  };
  // A gear to change down to, the shaft speed at which the change begins, and what follows.
  struct Descent {
    int gear;
    T from;
    Outcome outcome;
  };

  bool Floored() const { return in.pedal > p.floored_pedal; }
  bool Braking() const { return in.engine_brake > 0 && in.pedal < engine.pedal_up; }
  bool KicksDown() const {
    return in.pedal >= p.kick_down_pedal && in.driver_pedal - state.pedal > p.kick_down_rise;
  }
  T VehicleInertia() const { return gears.VehicleInertia(in.mass); }
  // The same with the parts that turn with the engine in a gear.
  T Inertia(int at) const {
    const T ratio = gears.Ratio(at);
    return VehicleInertia() + ratio * ratio * (engine.inertia + gears.InputInertia(at));
  }
  // Engine speed with the clutch closed.
  T InputSpeed() const { return gears.Ratio(gear) * in.shaft_speed; }
  // Greatest engine speed after a downshift.
  T Ceiling() const { return p.downshift_speed_max * engine.governed_speed; }
  T LowSpeed() const { return p.LowSpeed(engine, in.pedal); }

  // Engine speed after `recovery_horizon` in the present gear.
  T SpeedSoon() const {
    const T speed = in.shaft_speed + p.recovery_horizon * state.acceleration;
    return gears.Ratio(gear) * speed;
  }

  // Shaft speed at the end of a change that begins at the shaft speed `from`, under the load. The
  // torque falls linearly during the cut.
  T SpeedAfterChange(T from) const {
    T coasting = -state.load / VehicleInertia();
    if (in.pedal > engine.pedal_up) coasting = Min(coasting, state.acceleration);
    return from + change_time * coasting + 0.5 * cut_time * (state.acceleration - coasting);
  }

  // Torque at the propeller shaft behind all losses, for a torque of the engine, of which the
  // auxiliaries take their part; and the engine's torque for one at the shaft.
  T ShaftTorque(int at, T engine_torque, T engine_speed) const {
    return gears.ShaftTorque(at, engine_torque - engine.Auxiliary(engine_speed), engine_speed);
  }
  T EngineTorque(int at, T shaft_torque, T engine_speed) const {
    return gears.InputTorque(at, shaft_torque, engine_speed) + engine.Auxiliary(engine_speed);
  }
  // Torque at the shaft per torque at the gearbox input: a mean from zero to `torque`.
  T Transmission(int at, T torque, T engine_speed) const {
    const T idle = gears.ShaftTorque(at, 0, engine_speed);
    return (gears.ShaftTorque(at, torque, engine_speed) - idle) / torque;
  }

  // Whether a gear is engaged already.
  bool Stays(int next) const { return next == gear && !changing; }

  // Recovery of the engine's torque after a change to `next`, without a pause for the present gear.
  TorqueRecovery<T> Recovery(int next, T demand, T level, T drag) const {
    return engine.Recovery(in.engine, Stays(next) ? T(0) : change_time, demand, level, drag);
  }

  // Decrease of the shaft speed by a change to `next` that begins at `from`, and further until the
  // engine's torque has built up to the load; for the present gear, only the latter.
  Dip DipOf(int next, T from) const {
    const T after = Stays(next) ? from : SpeedAfterChange(from);
    if (in.pedal <= engine.pedal_up) {
      // Braked: the gear must fit for `recovery_horizon`.
      return {after, T(after + p.recovery_horizon * Min(0.0, state.acceleration)), 0};
    }
    const T speed = gears.Ratio(next) * after;
    // With a floored pedal the clutch slips rather than drag the engine below this speed.
    const T driven = Floored() ? Max(speed, LaunchSpeed(next)) : speed;
    const T demand = engine.PedalTorque(driven, in.pedal);
    const T level = EngineTorque(next, Max(0.0, state.load), speed);
    const TorqueRecovery<T> recovery = Recovery(next, demand, level, engine.drag(speed));
    if (recovery.time <= 0) return {after, after, 0};
    const T lost = recovery.impulse * Transmission(next, level, speed) / Inertia(next);
    return {after, after - lost, recovery.time};
  }
  T SpeedWhenRecovered(int next) const { return DipOf(next, in.shaft_speed).speed; }

  // Whether the gear, or a lower one, could not carry the present load before.
  bool Failed(int next) const { return state.failed_gear > 0 && next >= state.failed_gear; }

  // Whether the engine speed stays high enough while the torque builds up: with a floored pedal, it
  // may fall to `recovery_speed`, and below the lowest allowed speed for `recovery_time`. Since the
  // torque deficit decreases linearly, the speed falls to the dip in a parabola. A gear that failed
  // needs a margin, and one that is engaged has it.
  bool Bears(int next, const Dip& dip) const {
    const T margin = Stays(next) ? 1 / p.failed_reserve : Failed(next) ? p.failed_reserve : T(1);
    const T ratio = gears.Ratio(next) / margin, lowest = ratio * dip.speed;
    const T slow = LowSpeed(), low = p.upshift_speed * slow;
    if (lowest >= low) return true;
    if (!Floored() || lowest < p.recovery_speed * engine.idle_speed) return false;
    if (lowest >= slow) return true;
    const T first = ratio * dip.after;
    const T share = first > slow ? sqrt((slow - lowest) / (first - lowest)) : T(1);
    return share * dip.time * margin <= p.recovery_time;
  }

  // Torque at the shaft with the present pedal and a built-up charge, at a shaft speed.
  T FullTorque(int next, T shaft_speed) const {
    const T speed = gears.Ratio(next) * shaft_speed;
    return ShaftTorque(next, engine.PedalTorque(speed, in.pedal), speed);
  }

  // Whether torque over load is at least `reserve` at a shaft speed.
  bool Carries(int next, T shaft_speed, T reserve) const {
    return FullTorque(next, shaft_speed) >= reserve * Max(0.0, state.load);
  }

  // Engine speed at which a slipping clutch transmits the load, as in a launch.
  T LaunchSpeed(int next) const {
    const T level = EngineTorque(next, Max(0.0, state.load), engine.idle_speed);
    return engine.idle_speed + p.launch_range * level / engine.reference_torque;
  }

  // How a gear takes the load up again after a dip. An engaged gear may turn slower than one that
  // is chosen; on the way down the engine may be slow for long.
  Uptake UptakeOf(int next, const Dip& dip) const {
    const T ratio = gears.Ratio(next), margin = Stays(next) ? p.failed_reserve : T(1);
    const T turns = margin * ratio * dip.speed / engine.idle_speed;
    const bool bears = Bears(next, dip) || (next < gear && turns >= 1);
    if (bears && Carries(next, dip.speed, p.torque_reserve)) return kTurns;
    const T slowest = (Stays(next) ? kEngagedShare : 1.0) * p.relaunch_speed;
    const bool slips = Floored() && turns > slowest;
    return slips && Carries(next, LaunchSpeed(next) / ratio, p.torque_reserve) ? kSlips : kStops;
  }

  // What follows if the change to a gear begins at a shaft speed.
  Outcome After(int next, T from) const {
    const Dip dip = DipOf(next, from);
    const Uptake uptake = UptakeOf(next, dip);
    const T ratio = gears.Ratio(next), step = kHeldSpeedStep * engine.governed_speed / ratio;
    if (uptake == kStops) return {uptake, dip.speed};
    T held = uptake == kTurns ? dip.speed : Max(dip.speed, LaunchSpeed(next) / ratio);
    while (ratio * held < engine.governed_speed && Carries(next, held + step, 1)) held += step;
    return {uptake, held};
  }

  // Shaft speed below which the engine turns slowly enough for a change to a gear.
  T FastestChange(int next, T from) const {
    return Ceiling() / gears.Ratio(next) + from - SpeedAfterChange(from);
  }

  // Whether the present gear lasts from a shaft speed until a lower one: the engine stays above
  // `recovery_speed`, and is below the lowest speed for `recovery_time` at most.
  bool LastsUntil(T speed, T from) const {
    const T ratio = gears.Ratio(gear);
    if (speed >= from) return true;
    if (ratio * speed < p.recovery_speed * engine.idle_speed) return false;
    return Min(from, LowSpeed() / ratio) + p.recovery_time * state.acceleration <= speed;
  }

  // Highest gear to change to on the way from a shaft speed to a lower one at which the next change
  // begins; 0 if there is none, or no time for two changes.
  int GearBetween(int last, T from, T until) const {
    const T after = SpeedAfterChange(from);
    const T coasted = after + (after - from) * p.min_gear_time / change_time;
    if (coasted < until) return 0;
    for (int by = gear - 1; by > last && gears.Ratio(by) * after < Ceiling(); --by) {
      if (gears.Ratio(by) * until >= LowSpeed()) return by;
    }
    return 0;
  }

  // The best way down from a shaft speed: at once, in the present gear until the engine is slow
  // enough for a lower one, or by way of another gear. The present gear stays if the truck would
  // stop otherwise.
  Descent BestDescent(T from) const {
    Descent best = {gear, from, {kStops, -T(kInfinity)}}, far = best;
    if (Carries(gear, LaunchSpeed(gear) / gears.Ratio(gear), p.torque_reserve)) {
      best.outcome.speed = DipOf(gear, from).speed;
    }
    for (int next = gear - 1; next >= 1; --next) {
      const T begin = Min(from, FastestChange(next, from));
      if (best.outcome > Outcome{kTurns, engine.governed_speed / gears.Ratio(next)}) break;
      const Descent found = {next, begin, After(next, begin)};
      Descent& of = LastsUntil(begin, from) ? best : far;
      if (found.outcome > of.outcome) of = found;
    }
    if (!(far.outcome > best.outcome)) return best;
    const int by = GearBetween(far.gear, from, far.from);
    return by > 0 ? Descent{by, from, far.outcome} : best;
  }

  // Whether, with a floored pedal, the torque will carry the load before the engine is too slow.
  bool Recovers() const {
    if (!Floored()) return false;
    const Dip dip = DipOf(gear, in.shaft_speed);
    return UptakeOf(gear, dip) != kStops;
  }

  // Whether the gear must be right at once: in the lower half of the gears, or if a change costs
  // more than a share of the speed.
  bool CostlyChange(T lost, T share) const {
    return 2 * gear <= gears.count() || lost >= share * in.shaft_speed;
  }

  // Load at the end of a change that begins after a time [s]. Where a change costs much of the
  // speed, the load goes on to rise as it does now.
  T LoadAfter(T time) const {
    const T lost = in.shaft_speed - SpeedAfterChange(in.shaft_speed);
    if (!CostlyChange(lost, kCostlyChange)) return state.load;
    const T rate = Max(0.0, state.load - state.slow_load) / p.recovery_horizon;
    return state.load + (time + change_time + p.acceleration_lag + p.load_lag) * rate;
  }

  // Whether the load goes on to rise clearly, as on the foot of a ramp.
  bool LoadRises() const { return LoadAfter(0) > p.failed_reserve * Max(0.0, state.load); }

  // The best way down that begins after a time [s] in the present gear.
  Descent BestDescentAfter(T time) const {
    GearboxState<T> then = state;
    then.load = LoadAfter(time);
    const ShiftSituation later = {p, gears, engine, in, then, gear};
    return later.BestDescent(in.shaft_speed + time * state.acceleration);
  }

  // Whether, with a floored pedal, no speed will be held in the present gear after
  // `recovery_horizon`.
  bool LosesClimb() const {
    if (!Floored() || state.acceleration >= 0 || Recovers()) return false;
    const T ratio = gears.Ratio(gear), load = LoadAfter(p.recovery_horizon);
    const T step = kHeldSpeedStep * engine.governed_speed / ratio;
    const T slowest = LowSpeed() / ratio, fastest = engine.governed_speed / ratio;
    for (T speed = Min(SpeedWhenRecovered(gear), fastest); speed >= slowest; speed -= step) {
      if (FullTorque(gear, speed) >= load) return false;
    }
    return true;
  }

  // Whether the best lower gear now is better than after another `recovery_horizon`. A change that
  // is wanted begins after what is left of the delay.
  bool WaitingCosts() const {
    if (!LosesClimb()) return false;
    const T left = Max(0.0, p.downshift_delay - state.low_time);
    const Descent now = BestDescentAfter(left);
    if (now.gear == gear || now.from < in.shaft_speed + left * state.acceleration) return false;
    if (now.outcome.uptake == kStops) return true;
    const Outcome then = BestDescentAfter(left + p.recovery_horizon).outcome;
    return Outcome{now.outcome.uptake, T((1 - kHeldSpeedStep) * now.outcome.speed)} > then;
  }

  // Shaft speed after an upshift and the build-up of the torque; 0 if the pedal's torque does not
  // hold the load then. A gear that failed under this load needs a greater reserve.
  T SpeedAfterUpshift(int next) const { return SpeedAfterUpshift(next, in.shaft_speed); }
  T SpeedAfterUpshift(int next, T from) const {
    const T reserve = Failed(next) ? Max(p.failed_reserve, p.torque_reserve) : p.torque_reserve;
    const Dip dip = DipOf(next, from);
    if (Bears(next, dip) && Carries(next, dip.speed, reserve)) return dip.speed;
    // At its governor the engine gains nothing by waiting.
    const bool pays = AtGovernor() && !Failed(next) &&
                      After(next, from) > Outcome{kSlips, p.failed_reserve * in.shaft_speed};
    return pays ? dip.speed : T(0);
  }

  // Whether the governor holds the engine at its speed.
  bool AtGovernor() const {
    return Min(InputSpeed(), SpeedSoon()) >= (1 - engine.governor_droop) * engine.governed_speed &&
           SpeedSoon() < (1 + kHeldSpeedStep) * InputSpeed();
  }

  // Higher gear that holds the highest speed on the climb if the change begins now.
  Held FastestUpshift() const {
    Held best = {gear, 0};
    const int highest = Min(gears.count(), gear + p.skip_up_max);
    for (int next = gear + 1; next <= highest; ++next) {
      const T held = SpeedAfterUpshift(next) > 0 ? After(next, in.shaft_speed).speed : T(0);
      if (held > best.speed) best = {next, held};
    }
    return best;
  }

  // Whether the next but one gear, of the lower half, will hold the load when the next gear could
  // be left again: every change costs speed, and a gear for so short a time is not worth one.
  bool SkipsSoon() const {
    const int next = gear + 2;
    const T time = p.change_time + p.min_gear_time;
    const T soon = in.shaft_speed + time * Max(0.0, state.acceleration);
    return p.skip_up_max > 1 && 2 * next <= gears.count() && InputSpeed() < Ceiling() &&
           SpeedAfterUpshift(next, soon) > 0;
  }

  // Whether the torque at the wheels has built up to the pedal's demand, with the engine's speed
  // while the clutch slips.
  bool TorqueHasBuiltUp() const {
    const T speed = Max(InputSpeed(), in.engine.speed);
    const T full = ShaftTorque(gear, engine.PedalTorque(speed, in.pedal), speed);
    return in.shaft_torque > p.built_up_torque * full;
  }

  // Whether the engine would reach its governed speed at full load within the reversal time, so
  // that a downshift does not pay off.
  bool SoonOutgrown(int next) const {
    const T ratio = gears.Ratio(next);
    const T recovered = SpeedWhenRecovered(next);
    const T torque = ShaftTorque(next, engine.TorqueLimit(ratio * recovered), ratio * recovered);
    const T acceleration = (torque - state.load) / Inertia(next);
    return ratio * (recovered + p.reversal_time * acceleration) > engine.governed_speed;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_SHIFT_PREDICTION_H_
