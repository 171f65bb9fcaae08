// Diesel engine: pedal map, governors, torque rates and boost lag, engine brake, fuel.
#ifndef IITS_MJ_PLUGIN_LAWS_ENGINE_H_
#define IITS_MJ_PLUGIN_LAWS_ENGINE_H_

#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"

namespace iits {

template <class T>
struct EngineState {
  T speed;          // of the crankshaft [rad/s]
  T torque;         // indicated by combustion, before friction, >= 0 [N m]
  T boost_demand;   // rate-limited indicated torque that the charge pressure follows [N m]
  T boost;          // indicated torque that the present charge pressure allows [N m]
  T idle_integral;  // of the idle governor [N m]
  T brake_torque;   // of the engine brake, >= 0 [N m]
};

// Values of the curves at one speed, looked up once a step.
template <class T>
struct EnginePoint {
  T speed;      // [rad/s]
  T drag;       // friction and pumping torque, >= 0 [N m]
  T limit;      // greatest brake torque, with the top governor's droop [N m]
  T brake_max;  // of the engine brake, >= 0 [N m]
  T auxiliary;  // that the auxiliaries take from the crankshaft, >= 0 [N m]
};

// Demand of pedal and gearbox on the engine in this step.
template <class T>
struct EngineRequest {
  enum Mode {
    kPedal,  // torque by pedal and governors
    kCut,    // torque down to zero within time_left, before the clutch opens
    kSpeed,  // synchronize: bring the free engine to target_speed
  };
  Mode mode;
  T pedal;                // 0 to 1
  T engine_brake;         // share of the available torque, 0 to 1
  T time_left;            // kCut [s]
  T target_speed;         // kSpeed [rad/s]
  T inertia;              // kSpeed: of all parts that turn with the crankshaft [kg m2]
  bool limited = false;   // kPedal: the brakes reduce the torque, faster than the pedal
  bool relieved = false;  // kPedal: drag-torque control takes the engine brake away at once
  T torque = 0;           // kPedal: brake torque of the pedal at the present speed [N m]
};

// Recovery of the engine's torque up to a level.
template <class T>
struct TorqueRecovery {
  T impulse;  // missing angular impulse until then [N m s]
  T time;     // [s]
};

template <class T>
struct Engine {
  // Attributes.
  T idle_speed, governed_speed, governor_droop, reference_torque, inertia;
  T pedal_up, pedal_fade;
  T rise_rate, rise_rate_low, rise_threshold;
  T fall_rate, fall_rate_low, fall_threshold, cut_time, boost_lag, spool_time;
  T idle_gain, idle_integral_gain, idle_band, idle_integral_min, idle_integral_max;
  T idle_forget_time;
  T sync_lag, sync_torque_share, sync_brake_share;
  T brake_power, brake_speed, brake_exponent, brake_speed_min, brake_fade;
  T brake_lag, brake_release_lag;
  T idle_fuel_rate;
  Curve<T> full_load, drag;
  Map<T> pedal_map;
  Map<T> fuel_map;        // specific consumption over torque and speed [kg/J], or
  Map<T> fuel_rate;       // the rate over them [kg/s], which is used unless it is empty
  T fuel_factor = 1;      // on the rate of either map
  T auxiliary_power = 0;  // of the auxiliaries [W]
  // Derived by Prepare.
  UniformCurve<T> brake_torque;  // without the fade near idle

  // Samples P = engine_brake_power (w / engine_brake_speed)^exponent; the error is below 1e-5 of
  // the torque.
  void Prepare() {
    auto law = [this](T speed) {
      return RatedBrakeTorque() * pow(speed / brake_speed, brake_exponent - 1);
    };
    brake_torque.Sample(law, 0.2 * brake_speed, 1.2 * brake_speed, 256);
  }

  T RatedBrakeTorque() const { return brake_power / brake_speed; }

  // Recovery of the brake torque to `level` from the present state, with the pedal's torque
  // `demand`, after a pause of the combustion [s] in which the turbocharger loses charge. The
  // integral of UpdateBoost.
  TorqueRecovery<T> Recovery(const EngineState<T>& now, T pause, T demand, T level, T drag) const {
    if (level <= 0) return {0, 0};
    const T wanted = Max(demand, level) + drag, reached = level + drag;
    const T start = Max(now.boost_demand, rise_threshold);
    const T left = Max(start - pause * fall_rate_low, rise_threshold);
    // The charge pressure lags behind a falling or rising demand.
    const T fall = (start - left) / fall_rate_low, steady = fall_rate_low * boost_lag;
    T excess = Max(now.boost, rise_threshold) - start;
    if (pause > 0) {
      excess = steady + (excess - steady) * exp(-fall / boost_lag);
      excess *= exp(-(pause - fall) / boost_lag);
    }
    // The torque comes back quickly as far as the charge allows.
    const T first = pause > 0 ? T(0) : now.torque, last = Min(reached, left);
    const T ramp = Max(0.0, last - first) / rise_rate_low;
    const T quick = ramp * (reached - 0.5 * (first + last));
    const TorqueRecovery<T> rest = BoostRecovery(left, left + excess, wanted, reached);
    return {quick + rest.impulse, ramp + rest.time};
  }

  EnginePoint<T> At(T speed) const {
    const T friction = drag(speed);
    return {speed, friction, Limit(speed, friction), BrakeTorqueMax(speed), Auxiliary(speed)};
  }

  // Greatest brake torque, with the top governor's droop.
  T TorqueLimit(T speed) const { return Limit(speed, drag(speed)); }

  // Brake torque at a pedal position; with the pedal up, minus the drag.
  T PedalTorque(T speed, T pedal) const {
    const T friction = drag(speed);
    return PedalTorque({speed, friction, Limit(speed, friction), 0, 0}, pedal);
  }
  T PedalTorque(const EnginePoint<T>& at, T pedal) const {
    if (pedal <= 0) return -at.drag;
    const T wanted = Min(pedal_map(at.speed, pedal), at.limit);
    return Min(1.0, pedal / pedal_fade) * (wanted + at.drag) - at.drag;
  }

  // Torque of the auxiliaries: constant power above half of the idle speed, and proportional to the
  // speed below.
  T Auxiliary(T speed) const {
    if (auxiliary_power == 0) return 0;
    const T slow = 0.5 * idle_speed;
    return speed > slow ? auxiliary_power / speed : auxiliary_power * speed / (slow * slow);
  }

  // Torque at the crankshaft: combustion less friction and engine brake. The auxiliaries take their
  // part from it.
  T BrakeTorque(const EnginePoint<T>& at, const EngineState<T>& s) const {
    return s.torque - at.drag - s.brake_torque;
  }

  // Fuel rate [kg/s]; zero without combustion (overrun).
  T FuelRate(const EnginePoint<T>& at, const EngineState<T>& s) const {
    if (s.torque <= 0) return 0;
    return fuel_factor * (fuel_rate.rows.empty() ? ByConsumption(at, s) : ByRate(at, s));
  }

  // Advances torque, boost, idle governor and engine brake by h; the clutch advances the speed.
  void Update(const EngineRequest<T>& request, const EnginePoint<T>& at, T h,
              EngineState<T>* s) const {
    // In a gear change the turbocharger loses its charge for lack of load.
    if (request.mode != request.kPedal) UpdateBoost(0, h, s);
    if (request.mode == request.kSpeed) return Synchronize(request, at, h, s);
    UpdateBrake(request, at.brake_max, h, s);
    if (request.mode == request.kCut) {
      s->torque -= s->torque * Min(1.0, h / Max(request.time_left, h));
      return;
    }
    const T limit = at.limit + at.drag;
    const T wanted = request.torque + at.drag;
    const T demand = Min(limit, Max(wanted, IdleTorque(at, h, s)));
    UpdateBoost(demand, h, s);
    const T target = Min(demand, s->boost);
    if (target > s->torque) {
      s->torque = Min(target, s->torque + h * rise_rate_low);
    } else {
      T rate = s->torque > fall_threshold ? fall_rate : fall_rate_low;
      if (request.limited) rate = Max(rate, reference_torque / cut_time);
      s->torque = Max(target, s->torque - h * rate);
    }
    s->torque = Min(s->torque, limit);
  }

 private:
  // From the specific consumption, and below the map's lowest torque by a line through the idle
  // rate (Willans) to zero.
  T ByConsumption(const EnginePoint<T>& at, const EngineState<T>& s) const {
    const T torque = s.torque - at.drag;
    const T lowest = fuel_map.rows.front();
    if (torque >= lowest) return fuel_map(torque, at.speed) * torque * at.speed;
    const T no_load = idle_fuel_rate * at.speed / idle_speed;
    if (torque < 0) return no_load * s.torque / at.drag;
    const T at_lowest = fuel_map(lowest, at.speed) * lowest * at.speed;
    return no_load + (at_lowest - no_load) * torque / lowest;
  }

  // From the map of the rate, and below its lowest torque by a line to zero.
  T ByRate(const EnginePoint<T>& at, const EngineState<T>& s) const {
    const T torque = s.torque - at.drag, lowest = fuel_rate.rows.front();
    const T rate = fuel_rate(torque, at.speed);
    return torque < lowest ? rate * s.torque / (lowest + at.drag) : rate;
  }

  T Limit(T speed, T friction) const {
    const T governor = Clamp((governed_speed - speed) / (governor_droop * governed_speed), 0, 1);
    return governor * (full_load(speed) + friction) - friction;
  }

  // Greatest torque of the engine brake: the power law, with a fade near idle.
  T BrakeTorqueMax(T speed) const {
    if (speed <= brake_speed_min) return 0;
    return Min(1.0, (speed - brake_speed_min) / brake_fade) * brake_torque(speed);
  }

  // In indicated torques: deficit of the charge pressure during its rise from `boost` to `reached`,
  // with a demand that rises from `demand` toward `wanted` >= `reached`.
  TorqueRecovery<T> BoostRecovery(T demand, T boost, T wanted, T reached) const {
    if (reached <= demand) return {0, 0};
    // The demand first rises in proportion to its gap, then at its constant rate.
    const T rest = wanted - reached, gap = wanted - demand, linear = rise_rate * spool_time;
    const T last = Max(linear, rest);
    T impulse = boost_lag * (reached - boost), time = boost_lag;
    if (gap > last) {
      const T first = spool_time * log(gap / last);
      impulse += spool_time * (gap - last) - rest * first;
      time += first;
    }
    const T steady = Max(0.0, Min(gap, linear) - rest);
    impulse += 0.5 * steady * steady / rise_rate;
    return {T(Max(0.0, impulse)), time + steady / rise_rate};
  }

  // PI idle governor about the torque of friction and auxiliaries; indicated torque.
  T IdleTorque(const EnginePoint<T>& at, T h, EngineState<T>* s) const {
    const T error = idle_speed - at.speed;
    if (abs(error) < idle_band) {
      s->idle_integral += h * idle_integral_gain * error;
    } else {
      s->idle_integral -= s->idle_integral * h / (idle_forget_time + h);
    }
    s->idle_integral = Clamp(s->idle_integral, idle_integral_min, idle_integral_max);
    return Max(0.0, at.drag + at.auxiliary + idle_gain * error + s->idle_integral);
  }

  // Torque that the air allows: the rate-limited demand behind the turbocharger's lag. The torque
  // of a naturally aspirated engine is available at once.
  void UpdateBoost(T demand, T h, EngineState<T>* s) const {
    s->boost_demand = Max(s->boost_demand, rise_threshold);
    const T gap = demand - s->boost_demand;
    const T rise = h * Max(rise_rate, gap / spool_time);
    s->boost_demand += Clamp(gap, -h * fall_rate_low, rise);
    s->boost_demand = Max(s->boost_demand, rise_threshold);
    s->boost += (s->boost_demand - s->boost) * h / (boost_lag + h);
    s->boost = Max(s->boost, rise_threshold);
  }

  void UpdateBrake(const EngineRequest<T>& request, T available, T h, EngineState<T>* s) const {
    if (request.engine_brake <= 0 && s->brake_torque <= 0) return;
    const bool braking = request.mode == request.kPedal && request.pedal < pedal_up;
    const T brake = braking ? request.engine_brake * available : T(0);
    const T lag = braking && !request.relieved ? brake_lag : brake_release_lag;
    s->brake_torque += (brake - s->brake_torque) * h / (lag + h);
    s->brake_torque = Min(s->brake_torque, available);
  }

  // Brings the free engine to the speed of the new gear, if necessary with the engine brake.
  void Synchronize(const EngineRequest<T>& request, const EnginePoint<T>& at, T h,
                   EngineState<T>* s) const {
    const T wanted = request.inertia * (request.target_speed - at.speed) / (sync_lag + h);
    const T indicated = wanted + (at.drag + at.auxiliary);
    s->torque = Clamp(indicated, 0, sync_torque_share * reference_torque);
    s->brake_torque = Clamp(-indicated, 0, sync_brake_share * at.brake_max);
    s->idle_integral = 0;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_ENGINE_H_
