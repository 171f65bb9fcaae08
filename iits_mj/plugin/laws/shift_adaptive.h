// The "adaptive" shift strategy, by the load, which includes grade and mass.
#ifndef IITS_MJ_PLUGIN_LAWS_SHIFT_ADAPTIVE_H_
#define IITS_MJ_PLUGIN_LAWS_SHIFT_ADAPTIVE_H_

#include "plugin/laws/shift_prediction.h"

namespace iits {

// Greatest engine speed on a climb: downshifts end below it, and a floored pedal shifts up beyond.
template <class T>
T ClimbSpeed(const ShiftSituation<T>& now) {
  return now.p.adaptive_climb_speed * now.engine.governed_speed;
}

// Power at the wheels [W] in a gear with a floored pedal.
template <class T>
T AvailablePower(const ShiftSituation<T>& now, int gear, T shaft_speed) {
  const T speed = now.gears.Ratio(gear) * shaft_speed;
  return now.ShaftTorque(gear, now.engine.PedalTorque(speed, T(1)), speed) * shaft_speed;
}

// Power demand of the pedal at the wheels [W]: that of the present gear, and for a nearly floored
// pedal a share of the best gear's power.
template <class T>
T PowerWanted(const ShiftSituation<T>& now) {
  const ShiftParameters<T>& p = now.p;
  const T speed = now.in.shaft_speed;
  const T torque = now.engine.PedalTorque(now.InputSpeed(), now.in.pedal);
  const T wanted = now.ShaftTorque(now.gear, torque, now.InputSpeed()) * speed;
  if (!now.Floored()) return wanted;
  const T share = (now.in.pedal - p.floored_pedal) / (1 - p.floored_pedal);
  T greatest = 0;
  for (int gear = p.start_gear; gear <= now.gears.count(); ++gear) {
    if (now.gears.Ratio(gear) * speed > ClimbSpeed(now)) continue;
    greatest = Max(greatest, AvailablePower(now, gear, speed));
  }
  return Max(wanted, share * greatest / p.adaptive_reserve);
}

// Fuel rate [kg/s] for a torque of the engine at its speed.
template <class T>
T FuelRate(const ShiftSituation<T>& now, T engine_speed, T torque) {
  const EnginePoint<T> at = now.engine.At(engine_speed);
  EngineState<T> state = {};
  state.speed = at.speed;
  state.torque = torque + at.drag;
  return now.engine.FuelRate(at, state);
}

// Fuel rate [kg/s] for a power at the wheels in a gear.
template <class T>
T FuelFor(const ShiftSituation<T>& now, int gear, T shaft_speed, T power) {
  const T speed = now.gears.Ratio(gear) * shaft_speed;
  return FuelRate(now, speed, now.EngineTorque(gear, power / shaft_speed, speed));
}

// Work at the wheels [J] and fuel [kg] within the horizon.
template <class T>
struct ClimbAhead {
  T work, fuel;
};

// The climb within the horizon if the change to a gear begins now, under the present load. Includes
// the losses by the pause and by the build-up of the torque.
template <class T>
ClimbAhead<T> LookAhead(const ShiftSituation<T>& now, int gear) {
  constexpr double kLookStep = 0.5;  // [s]: numerical
  const Engine<T>& engine = now.engine;
  const T from = now.in.shaft_speed, load = now.state.load, inertia = now.Inertia(gear);
  const T ratio = now.gears.Ratio(gear);
  T speed = from, left = now.p.adaptive_horizon, angle = 0, fuel = 0;
  if (gear != now.gear) {
    speed = now.SpeedAfterChange(from);
    angle = 0.5 * (from + speed) * now.p.change_time;
    left -= now.p.change_time;
  }
  const T demand = engine.PedalTorque(ratio * speed, now.in.pedal);
  const TorqueRecovery<T> recovery = now.Recovery(gear, demand, demand, engine.drag(ratio * speed));
  // The missing impulse, distributed over the time of the recovery.
  const T missing = recovery.time > 0 ? recovery.impulse / recovery.time : T(0);
  T building = recovery.time;
  while (left > 0 && speed > 0) {
    const T step = Min(kLookStep, left);
    const T share = Min(building, step) / step;
    const T torque = engine.PedalTorque(ratio * speed, now.in.pedal) - share * missing;
    const T driving = now.ShaftTorque(gear, torque, ratio * speed);
    const T next = Max(0.0, speed + step * (driving - load) / inertia);
    fuel += step * FuelRate(now, T(ratio * speed), torque);
    angle += 0.5 * (speed + next) * step;
    speed = next;
    left -= step;
    building -= share * step;
  }
  return {T(0.5 * now.VehicleInertia() * (speed * speed - from * from) + load * angle), fuel};
}

// Work per cost, fuel plus priced time [J/kg]. A climb needs a certain work: the gear with the
// greatest ratio climbs at the least cost.
template <class T>
T WorkPerCost(const ShiftSituation<T>& now, int gear) {
  constexpr double kLeastPrice = 1e-6;  // [kg/s]: numerical, an engine may burn nothing
  const ClimbAhead<T> ahead = LookAhead(now, gear);
  const T price = Max(now.p.adaptive_time_price, kLeastPrice);
  return ahead.work / (ahead.fuel + price * now.p.adaptive_horizon);
}

// Whether an upshift may be worth its cost although it is not within the horizon: the engine is at
// its governor, or near it in a low gear, in which it stays on a long climb.
template <class T>
bool NearGovernor(const ShiftSituation<T>& now) {
  const Engine<T>& engine = now.engine;
  const bool low = 2 * now.gear < now.gears.count();
  return now.InputSpeed() >=
         (low ? now.Ceiling() : (1 - engine.governor_droop) * engine.governed_speed);
}

// Floored pedal: the gear that climbs at the least cost; a higher gear only beyond the greatest
// speed of a climb. The present gear stays unless another one does more work for its cost by
// `adaptive_gain`. Near the governor, the higher gear that holds the highest speed.
template <class T>
int ClimbingGear(const ShiftSituation<T>& now) {
  const ShiftParameters<T>& p = now.p;
  const T speed = now.in.shaft_speed;
  if (NearGovernor(now)) {
    const auto held = now.FastestUpshift();
    if (held.speed >
        (1 + p.adaptive_gain) * now.engine.governed_speed / now.gears.Ratio(now.gear)) {
      return held.gear;
    }
  }
  const T kept = WorkPerCost(now, now.gear);
  T most = kept + p.adaptive_gain * abs(kept);
  int best = now.gear;
  const int up = now.InputSpeed() < ClimbSpeed(now) ? 0 : p.skip_up_max;
  const int lowest = Max(p.start_gear, now.gear - p.skip_down_max);
  for (int gear = Min(now.gears.count(), now.gear + up); gear >= lowest; --gear) {
    if (gear == now.gear) continue;
    if (gear > now.gear && now.SpeedAfterUpshift(gear) <= 0) continue;
    if (gear < now.gear) {
      if (now.gears.Ratio(gear) * speed > ClimbSpeed(now) || now.SoonOutgrown(gear)) break;
      if (!now.Bears(gear, now.DipOf(gear, speed))) continue;
    }
    const T merit = WorkPerCost(now, gear);
    if (merit > most) {
      most = merit;
      best = gear;
    }
  }
  return best;
}

// The gear with the lowest fuel rate for the power demand, among those with an allowed engine speed
// and a torque reserve over load and power. The present gear stays unless another one saves
// `adaptive_gain` of its fuel, or the present one cannot give the power. Low gears are skipped.
template <class T>
int AdaptiveGear(const ShiftSituation<T>& now) {
  const ShiftParameters<T>& p = now.p;
  const T speed = now.in.shaft_speed;
  const T load = Max(0.0, now.state.load);
  const T wanted = Max(0.0, PowerWanted(now));
  const T slowest = now.LowSpeed();
  const T economic =
      now.Ceiling() * (p.adaptive_speed_max + (1 - p.adaptive_speed_max) * now.in.pedal);

  // The clutch slips or is open: the gears cannot be compared.
  if (now.InputSpeed() < p.LowSpeed(now.engine, 0)) return now.gear;
  // The present gear may use its reserve.
  const T needed = Max(wanted / p.adaptive_reserve, load * speed);
  const bool powerful = AvailablePower(now, now.gear, speed) >= needed;
  const bool fast = now.InputSpeed() >= ClimbSpeed(now);
  const bool able = powerful && !fast;
  // Floored pedal without enough power: the gear that climbs best. Fuel only decides on upshifts.
  const bool floored = now.in.pedal >= p.kick_down_pedal;
  if (floored && !able) {
    const int climbing = ClimbingGear(now);
    if (climbing != now.gear) return climbing;
  }
  T least = able ? (1 - p.adaptive_gain) * FuelFor(now, now.gear, speed, wanted) : T(kInfinity);
  // Near the governor the present gear gives less than the demand; another gear need not give more.
  // Beyond the greatest speed of a climb it only must hold the load.
  const T kept = fast ? T(0) : Min(wanted, AvailablePower(now, now.gear, speed));
  int best = now.gear;
  const int lowest = floored ? now.gear : Max(p.start_gear, now.gear - p.skip_down_max);
  const int highest = Min(now.gears.count(), now.gear + p.skip_up_max);
  for (int gear = lowest; gear <= highest; ++gear) {
    if (gear == now.gear) continue;
    if (gear < now.gear && (powerful != able || now.SoonOutgrown(gear))) continue;
    const T ratio = now.gears.Ratio(gear);
    if (ratio * speed > economic) continue;
    const T after = gear > now.gear ? now.SpeedAfterUpshift(gear) : now.SpeedWhenRecovered(gear);
    if (after <= 0 || (gear < now.gear && ratio * after < p.downshift_speed * slowest)) continue;
    if (AvailablePower(now, gear, after) < Max(kept, p.adaptive_reserve * load * after)) continue;
    const T fuel = FuelFor(now, gear, speed, wanted);
    if (fuel < least) {
      least = fuel;
      best = gear;
    }
  }
  return best == now.gear + 1 && now.SkipsSoon() ? now.gear : best;
}

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_SHIFT_ADAPTIVE_H_
