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
  T downshift_delay, downshift_margin, min_gear_time, reversal_time;
  T acceleration_lag, load_lag, pedal_lag;
  T lowest_speed, lowest_speed_pedal, rolling_speed;
  T recovery_horizon, recovery_speed, recovery_time;
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

  // Shaft speed in a change: after the clutch has closed, and at its minimum, a time [s] later.
  struct Dip {
    T after, speed, time;
  };
  struct Held {
    int gear;
    T speed;  // 0 if no gear holds the load
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
    const T demand = engine.PedalTorque(speed, in.pedal);
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

  // Whether the engine is not too slow after a dip, or gains speed again.
  bool Survives(int next, const Dip& dip) const {
    const T speed = gears.Ratio(next) * dip.speed;
    if (speed >= LowSpeed()) return true;
    return speed >= p.recovery_speed * engine.idle_speed && Carries(next, dip.speed, 1);
  }

  // Shaft speed up to which a gear carries the load after a change that begins at `from`; 0 if it
  // does not carry the load.
  T HeldSpeed(int next, T from) const {
    const Dip dip = DipOf(next, from);
    if (!Bears(next, dip) || !Carries(next, dip.speed, p.torque_reserve)) return 0;
    const T ratio = gears.Ratio(next);
    const T step = kHeldSpeedStep * engine.governed_speed / ratio;
    T held = dip.speed;
    while (ratio * held < engine.governed_speed && Carries(next, held + step, 1)) held += step;
    return held;
  }

  // Lower gear that holds the highest speed on the climb if the change begins at `from`.
  Held BestHeld(T from) const {
    const T after = SpeedAfterChange(from);
    Held best = {gear, 0};
    for (int next = gear - 1; next >= p.start_gear && gears.Ratio(next) * after < Ceiling();
         --next) {
      const T held = HeldSpeed(next, from);
      if (held > best.speed) best = {next, held};
    }
    return best;
  }

  // Whether a still lower gear will hold the load as soon as the engine is not too fast for it, and
  // the present gear lasts until then: within `recovery_time`, above `recovery_speed`.
  bool HoldsLater() const {
    const T lost = SpeedAfterChange(in.shaft_speed) - in.shaft_speed;
    for (int next = gear - 1; next >= p.start_gear; --next) {
      const T from = Ceiling() / gears.Ratio(next) - lost;
      if (from >= in.shaft_speed) continue;
      if (gears.Ratio(gear) * from < p.recovery_speed * engine.idle_speed) return false;
      if (in.shaft_speed + p.recovery_time * state.acceleration > from) return false;
      if (HeldSpeed(next, from) > 0) return true;
    }
    return false;
  }

  // Whether, with a floored pedal, the torque will carry the load before the engine is too slow.
  bool Recovers() const {
    if (!Floored()) return false;
    const Dip dip = DipOf(gear, in.shaft_speed);
    return Bears(gear, dip) && Carries(gear, dip.speed, p.torque_reserve);
  }

  // Load at the end of a change that begins after a time [s]. In the lower half of the gears, where
  // a change costs much of the speed, the load goes on to rise as it does now.
  T LoadAfter(T time) const {
    if (2 * gear > gears.count()) return state.load;
    const T rate = Max(0.0, state.load - state.slow_load) / p.recovery_horizon;
    return state.load + (time + change_time) * rate;
  }

  // Lower gear that holds this load if the change begins after a time [s] in the present gear.
  Held BestHeldAfter(T time) const {
    GearboxState<T> then = state;
    then.load = LoadAfter(time);
    const ShiftSituation later = {p, gears, engine, in, then, gear};
    return later.BestHeld(in.shaft_speed + time * state.acceleration);
  }

  // Whether, with a floored pedal, no speed will be held in the present gear after
  // `recovery_horizon`, and a lower gear that holds a speed now will hold a lower speed then.
  bool WaitingCosts() const {
    if (!Floored() || state.acceleration >= 0 || Recovers()) return false;
    const T ratio = gears.Ratio(gear), load = LoadAfter(p.recovery_horizon);
    const T step = kHeldSpeedStep * engine.governed_speed / ratio;
    const T slowest = LowSpeed() / ratio, fastest = engine.governed_speed / ratio;
    for (T speed = Min(SpeedWhenRecovered(gear), fastest); speed >= slowest; speed -= step) {
      if (FullTorque(gear, speed) >= load) return false;
    }
    const T held = BestHeldAfter(0).speed;
    if (held <= 0) return false;
    return BestHeldAfter(p.recovery_horizon).speed < (1 - kHeldSpeedStep) * held;
  }

  // Shaft speed after an upshift and the build-up of the torque; 0 if the pedal's torque does not
  // hold the load then. A gear that failed under this load needs a greater reserve.
  T SpeedAfterUpshift(int next) const { return SpeedAfterUpshift(next, in.shaft_speed); }
  T SpeedAfterUpshift(int next, T from) const {
    const T reserve = Failed(next) ? Max(p.failed_reserve, p.torque_reserve) : p.torque_reserve;
    const Dip dip = DipOf(next, from);
    return Bears(next, dip) && Carries(next, dip.speed, reserve) ? dip.speed : T(0);
  }

  // Higher gear that holds the highest speed on the climb if the change begins now.
  Held FastestUpshift() const {
    Held best = {gear, 0};
    const int highest = Min(gears.count(), gear + p.skip_up_max);
    for (int next = gear + 1; next <= highest; ++next) {
      const T held = SpeedAfterUpshift(next) > 0 ? HeldSpeed(next, in.shaft_speed) : T(0);
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
