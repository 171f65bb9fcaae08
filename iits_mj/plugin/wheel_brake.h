// One wheel end: brake chamber with ABS modulator, hysteresis and push-out, and the brake's grip.
#ifndef IITS_MJ_PLUGIN_WHEEL_BRAKE_H_
#define IITS_MJ_PLUGIN_WHEEL_BRAKE_H_

#include <algorithm>
#include <cmath>
#include <limits>

#include "plugin/dead_time.h"

namespace iits {

inline constexpr double kAtmosphere = 101325;  // [Pa]

// Share of the way that a first-order lag goes in one step: 1 - exp(-h / tau), by its Pade form.
inline double LagShare(double h, double tau) {
  double x = h / tau;
  return x / (1 + 0.5 * x + x * x / 12);
}

// What a wheel end remembers between steps, besides the wind-up.
struct WheelBrakeState {
  double pressure;    // in the chamber [Pa]
  double effective;   // the pressure that the friction of the mechanism lets through [Pa]
  double abs_active;  // 1: ABS keeps the pressure below the supply's
  double slip;        // behind the lag of ABS's differentiator; 0 without brake
};

// What follows from the time step, computed once since the step hardly ever changes.
struct WheelBrakeRates {
  double step;                         // [s]
  double build_up, release, abs;       // shares of the way to the target pressure
  double slip;                         // share of the way to the slip as it is
  double stiffness, damping, inverse;  // of the elastic brake [N m/rad], [N m s/rad], [rad/(N m s)]
};

struct WheelBrake {
  // Attributes, see README_air_brake.md.
  double dead_time, build_up_time_constant, release_time_constant;
  double torque_per_pressure, parking_torque, wheel_radius, chamber_volume;
  int circuit;
  double push_out_pressure, hysteresis_pressure;
  double abs_release_slip, abs_reapply_slip, abs_slip_lag, abs_slip_lead;
  double abs_speed_low, abs_speed_min;
  double abs_time_constant, abs_yaw_rise_rate;
  double stiffness;
  // From the model.
  int hub, dof;    // non-spinning body; degree of freedom of the wheel
  double inertia;  // about the spin axis [kg m2]

  // Greatest torque that the brake can hold or exert [N m]; `parking` is the share of the springs.
  double Torque(const WheelBrakeState& s, double parking) const {
    double service = torque_per_pressure * std::max(0.0, s.effective - push_out_pressure);
    return std::max(service, parking * parking_torque);
  }

  // Air in the chamber [Pa m3]: up to the push-out pressure it grows to its volume.
  double Air(const WheelBrakeState& s) const {
    double stroke = std::min(1.0, s.pressure / push_out_pressure);
    return chamber_volume * (s.pressure + stroke * kAtmosphere);
  }

  WheelBrakeRates Rates(double h) const {
    // Explicit in the wheel's speed: stiffness and damping stay inside the stable range of the
    // step.
    double k = std::min(stiffness, 0.4 * inertia / (h * h));
    double c = std::min(0.6 * std::sqrt(k * inertia), std::max(0.0, 0.7 * inertia / h - k * h));
    return {h,
            LagShare(h, build_up_time_constant),
            LagShare(h, release_time_constant),
            LagShare(h, abs_time_constant),
            LagShare(h, abs_slip_lag),
            k,
            c,
            1 / (k * h + c)};
  }

  // Elasto-plastic brake: a spring and damper on the wheel's angle that slips at `capacity`.
  // Semi-implicit in the angle; holds without creep, and never adds energy. Returns the torque.
  static double Grip(const WheelBrakeRates& rates, double capacity, double wheel_speed,
                     double* wind_up) {
    double torque =
        rates.stiffness * (*wind_up + rates.step * wheel_speed) + rates.damping * wheel_speed;
    torque = std::clamp(torque, -capacity, capacity);
    *wind_up = (rates.step * torque + rates.damping * *wind_up) * rates.inverse;
    return torque;
  }

  // Share of its time for which the ABS modulator fills (positive) or empties (negative) the
  // chamber; a pulse-width modulated valve acts as this mean, which is continuous in time and so
  // does not depend on the step. Fills all the time below the slip for reapplication, empties all
  // the time above that for release, and holds half-way. The rate of the slip counts, too, as a
  // wheel's deceleration does for every ABS: it damps the cycle of wheel and pressure. `slow`
  // becomes the slip behind the differentiator's lag.
  double Duty(const WheelBrakeRates& rates, const WheelBrakeState& s, double hub_speed,
              double wheel_speed, double* slow) const {
    *slow = 0;
    if (hub_speed < abs_speed_min || s.pressure <= push_out_pressure) return 1;
    double slip = (hub_speed - wheel_speed * wheel_radius) / std::max(hub_speed, abs_speed_low);
    *slow = s.slip + rates.slip * (slip - s.slip);
    double rate = (slip - 0.5 * (s.slip + *slow)) / abs_slip_lag;
    slip += (abs_slip_lead + rates.step) * rate;
    double middle = 0.5 * (abs_release_slip + abs_reapply_slip);
    return std::clamp((middle - slip) / (middle - abs_reapply_slip), -1.0, 1.0);
  }

  // Greatest rise of the pressure in one step [Pa]: on the steered axle slow beyond the pressure of
  // the `other` wheel while ABS works there, so that on a road with two surfaces the yaw moment
  // gives the driver time (modified individual control).
  double RiseMax(const WheelBrakeRates& rates, const WheelBrakeState& s,
                 const WheelBrakeState& other, bool other_active) const {
    if (circuit != kFront || !other_active) return std::numeric_limits<double>::infinity();
    double abreast = other.pressure + push_out_pressure - s.pressure;
    return std::max(abreast, rates.step * abs_yaw_rise_rate);
  }

  // Whether ABS works: from the first release until the chamber is as full as the supply again.
  bool Active(double supply, double duty, const WheelBrakeState& s) const {
    if (duty < 0) return true;
    return s.abs_active != 0 && (duty < 1 || s.pressure <= supply - push_out_pressure);
  }

  // Chamber pressure follows the supply line, by at most `rise_max`, unless ABS lets it go.
  void Update(const WheelBrakeRates& rates, double supply, double rise_max, double duty,
              WheelBrakeState* s) const {
    if (duty < 0) {
      s->pressure += duty * rates.abs * s->pressure;
    } else {
      double share = supply > s->pressure ? duty * rates.build_up : rates.release;
      s->pressure += std::min(rise_max, share * (supply - s->pressure));
    }
    // The effective pressure drags behind when the brake is let off.
    s->effective = std::clamp(s->effective, s->pressure, s->pressure + hysteresis_pressure);
    // What is left of a release is nothing.
    if (supply == 0 && s->pressure < 1e-3 * push_out_pressure) s->pressure = s->effective = 0;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_WHEEL_BRAKE_H_
