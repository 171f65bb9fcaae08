// What gearbox and shift strategy share: the gears, the state between steps, what the controller
// sees.
#ifndef IITS_MJ_PLUGIN_GEARS_H_
#define IITS_MJ_PLUGIN_GEARS_H_

#include <cstdlib>
#include <vector>

namespace iits {

// What the gearbox remembers between steps; whole numbers are kept as doubles.
struct GearboxState {
  double gear;          // engaged: 1 to n, 0 neutral, -1 reverse
  double target;        // gear that is wanted, equal to `gear` outside a change
  double phase;         // Gearbox::Phase
  double phase_time;    // since the phase began [s]
  double gear_time;     // since the last change ended [s]
  double low_time;      // for how long a lower gear has been called for [s]
  double shaft_speed;   // propeller shaft, low-passed [rad/s]
  double acceleration;  // of the propeller shaft, filtered [rad/s2]
  double torque;        // of the propeller shaft, low-passed as the speed is [N m]
  double load;          // filtered torque that would keep the shaft's speed [N m]
  double pedal;         // low-passed: a floored pedal far above it is a kick-down
  double direction;     // of the last change: 1 up, -1 down, 0 none yet
  double failed_gear;   // gear that could not carry the load, 0 none
  double failed_load;   // the load then [N m]
};

// What the gearbox controller sees.
struct GearboxInput {
  enum Mode { kDrive = 0, kNeutral = 1, kReverse = 2 };
  Mode mode;
  double pedal, engine_brake;        // as the engine gets them, 0 to 1
  double shaft_speed, shaft_torque;  // propeller shaft [rad/s], [N m]
  double engine_speed;
  bool clutch_open;
  double mass;                               // of the vehicle, as the model has it now [kg]
  double driver_pedal, driver_engine_brake;  // as the driver holds them, 0 to 1
};

struct Gears {
  std::vector<double> ratios;    // of gears 1 to n, falling
  std::vector<double> inertias;  // at the gearbox input [kg m2]
  double reverse_ratio;          // magnitude
  double final_drive;
  double gear_efficiency;
  double efficiency;         // from gearbox input to the wheels
  double meters_per_radian;  // of the propeller shaft

  int count() const { return static_cast<int>(ratios.size()); }
  // 0 in neutral, negative in reverse.
  double Ratio(int gear) const {
    return gear > 0 ? ratios[gear - 1] : (gear < 0 ? -reverse_ratio : 0);
  }
  double InputInertia(int gear) const { return gear ? inertias[std::abs(gear) - 1] : 0; }
  // Of the vehicle's mass about the propeller shaft [kg m2].
  double VehicleInertia(double mass) const { return mass * meters_per_radian * meters_per_radian; }
  // Vehicle speed [m/s].
  double Speed(double shaft_speed) const { return shaft_speed * meters_per_radian; }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_GEARS_H_
