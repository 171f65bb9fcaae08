// Common types of gearbox and shift strategy: gears, state, input of the controller.
#ifndef IITS_MJ_PLUGIN_LAWS_GEARS_H_
#define IITS_MJ_PLUGIN_LAWS_GEARS_H_

#include <cstdlib>
#include <vector>

#include "plugin/laws/engine.h"
#include "plugin/laws/gear_loss.h"
#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"

namespace iits {

// Whole numbers are stored as `T`, so that the state is an array of one type.
template <class T>
struct GearboxState {
  T gear;          // engaged: 1 to n, 0 neutral, -1 reverse
  T target;        // gear to engage, equal to `gear` outside a change
  T phase;         // Gearbox::Phase
  T phase_time;    // since the phase began [s]
  T gear_time;     // since the last change ended [s]
  T low_time;      // duration of the present demand for a lower gear [s]
  T shaft_speed;   // propeller shaft, low-passed [rad/s]
  T acceleration;  // of the propeller shaft, filtered [rad/s2]
  T torque;        // of the propeller shaft, with the low-pass of the speed [N m]
  T load;          // filtered torque at constant shaft speed [N m]
  T slow_load;     // the same, low-passed; it lags behind a load that rises [N m]
  T pedal;         // low-passed; a floored pedal far above it is a kick-down
  T direction;     // of the last change: 1 up, -1 down, 0 none yet
  T failed_gear;   // gear that could not carry the load, 0 none
  T failed_load;   // the load then [N m]
};

template <class T>
struct GearboxInput {
  enum Mode {
    kDrive = 0,
    kNeutral = 1,
    kReverse = 2
  };  // then drive with a request: gear 1, 2, ...
  Mode mode;
  T pedal, engine_brake;        // commands to the engine, 0 to 1
  T shaft_speed, shaft_torque;  // propeller shaft [rad/s], [N m]
  EngineState<T> engine;
  bool clutch_open;
  T mass;                               // of the vehicle at present [kg]
  T driver_pedal, driver_engine_brake;  // the driver's positions, 0 to 1
  int requested_gear;                   // 1 to n, 0 for an automatic choice
};

template <class T>
struct Gears {
  std::vector<T> ratios;        // of gears 1 to n, falling
  std::vector<T> inertias;      // at the gearbox input [kg m2]
  std::vector<T> efficiencies;  // of gears 1 to n
  T reverse_ratio;              // magnitude
  T final_drive;
  T driveline_efficiency;  // behind the gearbox
  T meters_per_radian;     // of the propeller shaft
  // Maps of losses, and the one of each gear: its index from 1, or 0 for none.
  std::vector<Map<T>> loss_maps;
  std::vector<int> map_of_gear;
  Map<T> axle_loss;        // instead of driveline_efficiency, unless it is empty
  Curve<T> retarder_drag;  // of the empty retarder, over the speed of the propeller shaft

  int count() const { return static_cast<int>(ratios.size()); }
  // A gear in the state.
  int Gear(T gear) const { return Whole(gear, -1, count()); }
  // 0 in neutral, negative in reverse.
  T Ratio(int gear) const {
    return gear > 0 ? ratios[gear - 1] : (gear < 0 ? -reverse_ratio : T(0));
  }
  // Losses of a gear, reverse has those of first gear; and of all behind the gearbox.
  GearLoss<T> Loss(int gear) const {
    const int row = gear > 0 ? gear - 1 : 0;
    const int map = map_of_gear.empty() ? 0 : map_of_gear[row];
    return {efficiencies[row], map ? &loss_maps[map - 1] : nullptr};
  }
  GearLoss<T> AxleLoss() const {
    return {driveline_efficiency, axle_loss.rows.empty() ? nullptr : &axle_loss};
  }
  // Drag torque of the empty retarder [N m].
  T RetarderDrag(T shaft_speed) const {
    return retarder_drag.x.empty() ? T(0) : retarder_drag(T(abs(shaft_speed)));
  }
  // Torque at the propeller shaft behind all losses, for a torque at the gearbox input, which turns
  // at `speed`, well above zero; without the retarder's braking. For predictions.
  T ShaftTorque(int gear, T torque, T speed) const {
    const T shaft_speed = speed / Ratio(gear);
    const T geared = Loss(gear).Behind(torque, speed) * Ratio(gear);
    return AxleLoss().Behind(geared - RetarderDrag(shaft_speed), shaft_speed);
  }
  // Torque at the gearbox input for one at the shaft: inverse of ShaftTorque.
  T InputTorque(int gear, T shaft_torque, T speed) const {
    const T shaft_speed = speed / Ratio(gear);
    const T geared = AxleLoss().Before(shaft_torque, shaft_speed) + RetarderDrag(shaft_speed);
    return Loss(gear).Before(geared / Ratio(gear), speed);
  }
  T InputInertia(int gear) const { return gear ? inertias[std::abs(gear) - 1] : T(0); }
  // Inertia of the vehicle's mass about the propeller shaft [kg m2].
  T VehicleInertia(T mass) const { return mass * meters_per_radian * meters_per_radian; }
  // Vehicle speed [m/s].
  T Speed(T shaft_speed) const { return shaft_speed * meters_per_radian; }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_GEARS_H_
