// One wheel end: brake chamber with ABS modulator, hysteresis and push-out, and the brake's grip.
#ifndef IITS_MJ_PLUGIN_WHEEL_BRAKE_H_
#define IITS_MJ_PLUGIN_WHEEL_BRAKE_H_

#include <algorithm>
#include <cmath>

namespace iits {

// Share of the way that a first-order lag goes in one step: 1 - exp(-h / tau), by its Pade form.
inline double LagShare(double h, double tau) {
  double x = h / tau;
  return x / (1 + 0.5 * x + x * x / 12);
}

// What a wheel end remembers between steps, besides the wind-up.
struct WheelBrakeState {
  double pressure;   // in the chamber [Pa]
  double effective;  // the pressure that the friction of the mechanism lets through [Pa]
  double abs_phase;  // WheelBrake::AbsPhase
  double abs_limit;  // pressure allowed while ABS lets it rise again [Pa]
};

// What follows from the time step, computed once since the step hardly ever changes.
struct WheelBrakeRates {
  double step;                         // [s]
  double build_up, release, abs;       // shares of the way to the target pressure
  double stiffness, damping, inverse;  // of the elastic brake [N m/rad], [N m s/rad], [rad/(N m s)]
};

struct WheelBrake {
  enum AbsPhase { kNormal = 0, kRelease, kReapply };

  // Attributes, see README_air_brake.md.
  double dead_time, build_up_time_constant, release_time_constant;
  double torque_per_pressure, parking_torque, wheel_radius;
  int circuit;
  double push_out_pressure, hysteresis_pressure;
  double abs_release_slip, abs_reapply_slip, abs_speed_min;
  double stiffness;
  // From the model.
  int hub, dof;    // non-spinning body; degree of freedom of the wheel
  double inertia;  // about the spin axis [kg m2]

  // Greatest torque that the brake can hold or exert [N m]; `parking` is the share of the springs.
  double Torque(const WheelBrakeState& s, double parking) const {
    double service = torque_per_pressure * std::max(0.0, s.effective - push_out_pressure);
    return std::max(service, parking * parking_torque);
  }

  WheelBrakeRates Rates(double h) const {
    // Explicit in the wheel's speed: stiffness and damping stay inside the stable range of the
    // step.
    double k = std::min(stiffness, 0.4 * inertia / (h * h));
    double c = std::min(0.6 * std::sqrt(k * inertia), std::max(0.0, 0.7 * inertia / h - k * h));
    return {h,
            LagShare(h, build_up_time_constant),
            LagShare(h, release_time_constant),
            LagShare(h, kAbsTimeConstant),
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

  // Chamber pressure follows the supply line, unless ABS lets it go.
  void Update(const WheelBrakeRates& rates, double supply, double hub_speed, double wheel_speed,
              WheelBrakeState* s) const {
    UpdateAbs(supply, hub_speed, wheel_speed, rates.step, s);
    double target = supply, share = supply > s->pressure ? rates.build_up : rates.release;
    if (s->abs_phase != kNormal) {
      target = s->abs_phase == kRelease ? 0 : std::min(supply, s->abs_limit);
      share = rates.abs;
    }
    s->pressure += share * (target - s->pressure);
    // The effective pressure drags behind when the brake is let off.
    s->effective = std::clamp(s->effective, s->pressure, s->pressure + hysteresis_pressure);
  }

 private:
  static constexpr double kAbsTimeConstant =
      0.08;                                      // of the modulator at the chamber [s], judgement
  static constexpr double kAbsRiseRate = 200e3;  // after a release [Pa/s], judgement
  static constexpr double kAbsReapplyShare = 0.85;  // of the pressure at which the wheel locked

  void UpdateAbs(double supply, double hub_speed, double wheel_speed, double h,
                 WheelBrakeState* s) const {
    if (hub_speed < abs_speed_min) {
      s->abs_phase = kNormal;
      return;
    }
    double slip = 1 - wheel_speed * wheel_radius / hub_speed;
    if (s->abs_phase != kRelease && slip > abs_release_slip && s->pressure > push_out_pressure) {
      s->abs_phase = kRelease;
      s->abs_limit = kAbsReapplyShare * s->pressure;
    } else if (s->abs_phase == kRelease && slip < abs_reapply_slip) {
      s->abs_phase = kReapply;
    } else if (s->abs_phase == kReapply) {
      s->abs_limit += h * kAbsRiseRate;
      if (s->abs_limit > supply) s->abs_phase = kNormal;
    }
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_WHEEL_BRAKE_H_
