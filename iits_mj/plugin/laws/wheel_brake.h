// One wheel end: brake chamber with ABS modulator, hysteresis and push-out, and the brake's grip.
#ifndef IITS_MJ_PLUGIN_LAWS_WHEEL_BRAKE_H_
#define IITS_MJ_PLUGIN_LAWS_WHEEL_BRAKE_H_

#include "plugin/laws/dead_time.h"
#include "plugin/laws/number.h"

namespace iits {

inline constexpr double kAtmosphere = 101325;  // [Pa]

template <class T>
struct WheelBrakeState {
  T pressure;    // in the chamber [Pa]
  T effective;   // pressure behind the hysteresis of the mechanism [Pa]
  T abs_active;  // 1: ABS keeps the pressure below that of the supply
  T slip;        // behind the lag of ABS's differentiator; 0 without brake
  T mean;        // of the pressure, low-passed: what the road carries while ABS works [Pa]
};

// Constants of a time step, computed once because the step rarely changes.
template <class T>
struct WheelBrakeRates {
  T step;                         // [s]
  T build_up, release, abs;       // shares of the difference to the target pressure
  T slip;                         // share of the difference to the present slip
  T mean;                         // share of the difference to the present pressure
  T stiffness, damping, inverse;  // of the elastic brake [N m/rad], [N m s/rad], [rad/(N m s)]
};

template <class T>
struct WheelBrake {
  // Attributes.
  T dead_time, build_up_time_constant, release_time_constant;
  T torque_per_pressure, parking_torque, wheel_radius, chamber_volume;
  int circuit;
  T push_out_pressure, hysteresis_pressure;
  T abs_release_slip, abs_reapply_slip, abs_slip_lag, abs_slip_lead;
  T abs_speed_low, abs_speed_min;
  T abs_time_constant, abs_yaw_share, abs_yaw_rise_rate;
  T abs_pressure_lag, abs_refill_share, abs_rise_time;
  T stiffness;
  bool lifted = false;  // in the air: without service brake, ABS, and part in braking
  T inertia;            // of the wheel about its spin axis, from the model [kg m2]

  // Greatest torque of the brake [N m]; `parking` is the applied share of the spring brakes.
  T Torque(const WheelBrakeState<T>& s, T parking) const {
    const T service = torque_per_pressure * Max(0.0, s.effective - push_out_pressure);
    return Max(service, parking * parking_torque);
  }

  // Air in the chamber [Pa m3]; the chamber reaches its full volume at the push-out pressure.
  T Air(const WheelBrakeState<T>& s) const {
    const T stroke = Min(1.0, s.pressure / push_out_pressure);
    return chamber_volume * (s.pressure + stroke * kAtmosphere);
  }

  // Slip in the direction of travel: positive if the wheel turns slower than the road.
  T Slip(T hub_speed, T wheel_speed) const {
    const T speed = abs(hub_speed);
    return (speed - abs(wheel_speed) * wheel_radius) / Max(speed, abs_speed_low);
  }

  WheelBrakeRates<T> Rates(T h) const {
    // Explicit in the wheel's speed: stiffness and damping are limited to the stable range.
    const T k = Min(stiffness, 0.4 * inertia / (h * h));
    const T c = Min(0.6 * sqrt(k * inertia), Max(0.0, 0.7 * inertia / h - k * h));
    return {h,
            LagShare(h, build_up_time_constant),
            LagShare(h, release_time_constant),
            LagShare(h, abs_time_constant),
            LagShare(h, abs_slip_lag),
            LagShare(h, abs_pressure_lag),
            k,
            c,
            1 / (k * h + c)};
  }

  // Elasto-plastic brake: a spring and damper on the wheel's angle that slips at `capacity`.
  // Semi-implicit in the angle; holds without creep, and never adds energy. Returns the torque.
  static T Grip(const WheelBrakeRates<T>& rates, T capacity, T wheel_speed, T* wind_up) {
    T torque =
        rates.stiffness * (*wind_up + rates.step * wheel_speed) + rates.damping * wheel_speed;
    torque = Clamp(torque, -capacity, capacity);
    *wind_up = (rates.step * torque + rates.damping * *wind_up) * rates.inverse;
    return torque;
  }

  // Share of time in which the ABS modulator fills (positive) or empties (negative) the chamber:
  // the mean of a pulse-width modulated valve, which is continuous in time and so does not depend
  // on the step. The valve only fills below the slip for reapplication, only empties above the slip
  // for release, and holds half-way. The rate of the slip damps the cycle of wheel and pressure, as
  // the wheel's deceleration does in every ABS. It fades out between the least speed of ABS and
  // half of it. `slow` becomes the slip behind the differentiator's lag.
  T Duty(const WheelBrakeRates<T>& rates, const WheelBrakeState<T>& s, T hub_speed, T wheel_speed,
         T* slow) const {
    *slow = 0;
    const T fade = Clamp(2 * hub_speed / abs_speed_min - 1, 0.0, 1.0);
    if (fade == 0 || s.effective <= push_out_pressure) return 1;
    T slip = (hub_speed - wheel_speed * wheel_radius) / Max(hub_speed, abs_speed_low);
    *slow = s.slip + rates.slip * (slip - s.slip);
    const T rate = (slip - 0.5 * (s.slip + *slow)) / abs_slip_lag;
    slip += (abs_slip_lead + rates.step) * rate;
    const T middle = 0.5 * (abs_release_slip + abs_reapply_slip);
    const T duty = Clamp((middle - slip) / (middle - abs_reapply_slip), -1.0, 1.0);
    return 1 - fade * (1 - duty);
  }

  // Greatest rise of the pressure in one step [Pa]. While ABS works, the modulator refills the
  // chamber to a share of its mean pressure and from there by short pulses, so that the wheel
  // passes the peak of friction slowly. On the steered axle the rise is slow beyond a multiple of
  // the pressure of the `other` wheel while ABS works there, so that on a road with two surfaces
  // the yaw moment leaves the driver time (modified individual control).
  T RiseMax(const WheelBrakeRates<T>& rates, const WheelBrakeState<T>& s, bool active,
            const WheelBrakeState<T>& other, bool other_active) const {
    T most = kInfinity;
    if (active) {
      const T refill = abs_refill_share * s.mean - s.pressure;
      most = Max(0.0, refill) + rates.step * (s.mean + push_out_pressure) / abs_rise_time;
    }
    if (circuit == kFront && other_active) {
      const T abreast = abs_yaw_share * other.pressure + push_out_pressure - s.pressure;
      most = Min(most, Max(abreast, rates.step * abs_yaw_rise_rate));
    }
    return most;
  }

  // Whether ABS is active: from the first release until the chamber reaches the supply pressure.
  bool Active(T supply, T duty, const WheelBrakeState<T>& s) const {
    if (duty < 0) return true;
    return s.abs_active != 0 && (duty < 1 || s.pressure <= supply - push_out_pressure);
  }

  // Chamber pressure follows the supply line, by at most `rise_max`, unless ABS empties it.
  void Update(const WheelBrakeRates<T>& rates, T supply, T rise_max, T duty,
              WheelBrakeState<T>* s) const {
    if (duty < 0) {
      s->pressure += duty * rates.abs * s->pressure;
    } else {
      const T share = supply > s->pressure ? duty * rates.build_up : rates.release;
      s->pressure += Min(rise_max, share * (supply - s->pressure));
    }
    s->mean += rates.mean * (s->pressure - s->mean);
    // The effective pressure lags when the brake is released.
    s->effective = Clamp(s->effective, s->pressure, s->pressure + hysteresis_pressure);
    // The last part of a release is set to zero.
    if (supply == 0 && s->pressure < 1e-3 * push_out_pressure)
      s->pressure = s->effective = s->mean = 0;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_WHEEL_BRAKE_H_
