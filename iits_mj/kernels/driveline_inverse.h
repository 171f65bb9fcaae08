// Inverse powertrain: accelerator, engine brake, retarder and rest for a force at the wheels.
//
// `controllers/tracking/driveline_inverse.py` describes the laws and packs the constants.
#ifndef IITS_MJ_KERNELS_DRIVELINE_INVERSE_H_
#define IITS_MJ_KERNELS_DRIVELINE_INVERSE_H_

#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels/rounding.h"

namespace iits {

// Numbers of the powertrain. The tables follow: overall ratio of each gear, equivalent mass of what
// turns with it, its efficiency from engine to wheels, speeds and torques of the engine's drag,
// then the speeds, pedals, share of traction over the pedals, and torques (a row each speed) of the
// map.
struct Powertrain {
  double rolling, drag, wheel_mass;
  double radius, shaft, driveline_efficiency, auxiliary_power;
  double brake_speed_min, brake_speed, brake_torque, brake_exponent, brake_fade;
  double retarder_speed, retarder_torque, retarder_power;
  double gear_count, drag_count, speed_count, pedal_count;

  const double* gears() const { return reinterpret_cast<const double*>(this + 1); }
  const double* tables() const { return gears() + 3 * static_cast<int>(gear_count); }
  // Overall ratio, equivalent mass [kg] and efficiency of a forward gear.
  double Ratio(double gear) const { return gears()[Row(gear)]; }
  double Spin(double gear) const { return gears()[static_cast<int>(gear_count) + Row(gear)]; }
  double Efficiency(double gear) const {
    return gears()[2 * static_cast<int>(gear_count) + Row(gear)];
  }

 private:
  int Row(double gear) const {
    return static_cast<int>(std::min(std::max(gear, 1.0), gear_count)) - 1;
  }
};

// What each actuator does: torque at the crankshaft, drag of the engine on overrun (positive) [N
// m], accelerator pedal, braking force beyond the drag [N], shares of the greatest force of engine
// brake and retarder, and the force that all of them lack, now or once friction has built up [N].
struct Actuation {
  double torque, drag, pedal, beyond, engine_brake, retarder, lacking;
};

// Greatest forces at the wheels [N].
struct Forces {
  double drag, engine_brake, retarder;
};

constexpr double kSlowestEngine = 50.0;  // [rad/s], below the idle speed of every truck
constexpr double kGravity = 9.81;        // [m/s2], that of iits_mj/core/units.py

// Between (x0, y0) and (x1, y1), rounded as `numpy.interp`.
inline double Between(double x, double x0, double x1, double y0, double y1) {
  return x == x0 ? y0 : (y1 - y0) / (x1 - x0) * (x - x0) + y0;
}

// Drag of the engine on overrun [N m].
inline double DragTorque(const Powertrain& p, double engine_speed) {
  const int count = p.drag_count;
  const double *speeds = p.tables(), *torques = speeds + count;
  const int next = std::upper_bound(speeds, speeds + count, engine_speed) - speeds;
  if (next == 0 || next == count) return torques[std::max(next - 1, 0)];
  return Between(engine_speed, speeds[next - 1], speeds[next], torques[next - 1], torques[next]);
}

// Torque of the auxiliaries on the crankshaft [N m]; bounded for an engine that is nearly stalled.
inline double AuxiliaryTorque(const Powertrain& p, double engine_speed) {
  return p.auxiliary_power / std::max(engine_speed, kSlowestEngine);
}

// Greatest torque of the engine brake beyond the drag [N m]: a power law, 0 at idle.
inline double EngineBrakeTorque(const Powertrain& p, double engine_speed) {
  const double above = engine_speed - p.brake_speed_min;
  if (above <= 0.0) return 0.0;
  const double torque = p.brake_torque * std::pow(engine_speed / p.brake_speed, p.brake_exponent);
  return std::min(above / p.brake_fade, 1.0) * torque;
}

// Greatest torque of the cold retarder at the propeller shaft [N m].
inline double RetarderTorque(const Powertrain& p, double shaft_speed) {
  if (shaft_speed <= 0.0) return 0.0;
  const double rise = std::min(shaft_speed / p.retarder_speed, 1.0);
  return std::min(p.retarder_torque * Square(rise), p.retarder_power / shaft_speed);
}

// Forces increased by losses; in a gear change only the retarder brakes. The auxiliaries brake with
// the engine's drag.
inline Forces Endurance(const Powertrain& p, double speed, double engine_speed, double gear,
                        bool engaged) {
  const double retarder = RetarderTorque(p, speed * p.shaft) * p.shaft / p.driveline_efficiency;
  if (!engaged) return {0.0, 0.0, retarder};
  const double factor = p.Ratio(gear) / p.radius / p.Efficiency(gear);
  const double drag = DragTorque(p, engine_speed) + AuxiliaryTorque(p, engine_speed);
  return {factor * drag, factor * EngineBrakeTorque(p, engine_speed), retarder};
}

// Takes the force that a brake can give from the rest; returns its share of the greatest one.
inline double Take(double available, double* rest) {
  if (available <= 0.0) return 0.0;
  const double share = std::min(*rest / available, 1.0);
  *rest = std::max(*rest - available, 0.0);
  return share;
}

// Divides a braking force: engine drag, engine brake, retarder, friction in this order.
inline void ShareOut(double force, const Forces& forces, Actuation* a) {
  a->beyond = a->lacking = std::max(force - forces.drag, 0.0);
  a->engine_brake = Take(forces.engine_brake, &a->lacking);
  a->retarder = Take(forces.retarder, &a->lacking);
}

// Accelerator pedal, 0 to 1, for a torque at the crankshaft [N m].
inline double Pedal(const Powertrain& p, double torque, double engine_speed, double drag) {
  const int count = p.speed_count, pedals = p.pedal_count;
  const double* speeds = p.tables() + 2 * static_cast<int>(p.drag_count);
  const double *positions = speeds + count, *fade = positions + pedals;
  const int next = std::lower_bound(speeds, speeds + count, engine_speed) - speeds;
  const int row = std::min(std::max(next - 1, 0), count - 2);
  const double *low = fade + (row + 1) * pedals, *high = low + pedals;
  const double span = speeds[row + 1] - speeds[row];
  const double share = std::min(std::max((engine_speed - speeds[row]) / span, 0.0), 1.0);
  double most = -std::numeric_limits<double>::infinity(), before = most;
  for (int i = 0; i < pedals; ++i) {
    // Over the first travel of the pedal, overrun changes to traction.
    const double full = (1.0 - share) * low[i] + share * high[i];
    most = std::max(most, fade[i] * (full + drag) - drag);
    // Slightly rising, so that a flat map has an inverse.
    const double here = most + 1e-6 * i;
    if (here > torque) {
      if (i == 0) return positions[0];
      return Between(torque, before, here, positions[i - 1], positions[i]);
    }
    before = here;
  }
  return positions[pedals - 1];
}

// Rolling, air and grade resistance [N] at a grade (rise over run).
inline double Resistance(const Powertrain& p, double mass, double speed, double grade) {
  const double slope = std::atan(grade);
  const double rolling = speed > 0.05 ? p.rolling * std::cos(slope) : 0.0;
  return mass * kGravity * (std::sin(slope) + rolling) + p.drag * speed * std::fabs(speed);
}

// What each actuator does for a force at the wheels [N], negative when it brakes.
//
// Args: `gear` is the engaged or last engaged one; `engaged` is false in a gear change;
// `speed_soon` [m/s] is the speed at which friction, if it were demanded now, would act.
inline Actuation Actuate(const Powertrain& p, double force, double speed, double engine_speed,
                         double gear, bool engaged, double speed_soon) {
  const double bare = force * p.radius / p.Ratio(gear), efficiency = p.Efficiency(gear);
  Actuation a;
  a.torque = bare > 0.0 ? bare / efficiency : bare * efficiency;
  a.torque += AuxiliaryTorque(p, engine_speed);
  a.drag = DragTorque(p, engine_speed);
  a.pedal = Pedal(p, a.torque, engine_speed, a.drag);
  ShareOut(-force, Endurance(p, speed, engine_speed, gear, engaged), &a);
  const double engine_speed_soon = engine_speed * speed_soon / std::max(speed, 0.1);
  Actuation soon;
  ShareOut(-force, Endurance(p, speed_soon, engine_speed_soon, gear, engaged), &soon);
  a.lacking = std::max(a.lacking, soon.lacking);
  return a;
}

}  // namespace iits

#endif  // IITS_MJ_KERNELS_DRIVELINE_INVERSE_H_
