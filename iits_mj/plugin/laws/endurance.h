// Endurance brakes: the signals that brakes and powertrain exchange, as TSC1 and ERC1 do on a
// truck's bus, and how a demand is shared among engine drag, engine brake and retarder.
#ifndef IITS_MJ_PLUGIN_LAWS_ENDURANCE_H_
#define IITS_MJ_PLUGIN_LAWS_ENDURANCE_H_

#include "plugin/laws/number.h"

namespace iits {

// From the brakes to the powertrain; all zero: no demand.
template <class T>
struct EnduranceDemand {
  // ABS works on the driven wheels: engine brake and retarder release, even if the driver's
  // levers ask for them. Any negative torque means this.
  static constexpr double kRelease = -1;

  T shaft_torque;  // retarding torque wanted at the propeller shaft [N m]
  T cut_traction;  // 1: the engine does not pull against the brakes
};

// From the powertrain to the brakes.
template <class T>
struct EnduranceState {
  T shaft_torque;      // retarding torque at the propeller shaft, all sources, signed [N m]
  T shaft_torque_max;  // the greatest that engine drag, engine brake and retarder could give [N m]
  T engine_speed;      // [rad/s]: drives the air compressor
};

// Positions of the driver's pedal and levers, each 0 to 1.
template <class T>
struct EnduranceLevers {
  T pedal, engine_brake, retarder;
};

// How engine torque reaches the propeller shaft in the present state of the driveline.
template <class T>
struct EnduranceGearing {
  T engine_factor;    // shaft torque per engine torque in overrun; 0: clutch open or changing gear
  T retarder_factor;  // shaft torque per retarder torque
};

// Commands to engine and retarder.
template <class T>
struct EnduranceCommand {
  T pedal;            // accelerator, as far as the brakes allow it, 0 to 1
  T engine_brake;     // share of the available torque, 0 to 1
  T retarder_torque;  // [N m]
};

// The brakes ask for a total retarding torque at the shaft, which includes the drag. The retarder
// is asked for what engine drag and engine brake cannot give; in a gear change, for everything. In
// a lower gear the engine can give more: then one rises while the other falls, each with its lag.
// The driver's levers ask for at least their share; a pressed accelerator turns everything off
// unless the brakes cut it.
template <class T>
struct EnduranceControl {
  T pedal_up;     // accelerator travel below which the engine may brake
  T return_time;  // in which the accelerator comes back after a cut [s]

  // `held_back`, 0 to 1, is the withheld part of the accelerator.
  EnduranceCommand<T> Update(const EnduranceLevers<T>& levers, const EnduranceDemand<T>& demand,
                             const EnduranceGearing<T>& gearing, T drag, T brake_max,
                             T retarder_max, T h, T* held_back) const {
    const T cut = Clamp(demand.cut_traction, 0.0, 1.0);
    *held_back = Max(cut, *held_back - h / return_time);
    EnduranceCommand<T> command = {levers.pedal * (1 - *held_back), 0, 0};
    if (command.pedal >= pedal_up || demand.shaft_torque < 0) return command;
    command.engine_brake = levers.engine_brake;
    command.retarder_torque = levers.retarder * retarder_max;
    if (!(demand.shaft_torque > 0)) return command;
    if (gearing.engine_factor > 0 && brake_max > 0) {
      const T wanted = demand.shaft_torque / gearing.engine_factor - drag;
      command.engine_brake = Max(command.engine_brake, Clamp(wanted / brake_max, 0.0, 1.0));
    }
    const T engine = gearing.engine_factor * (drag + brake_max);
    const T rest = (demand.shaft_torque - engine) / gearing.retarder_factor;
    command.retarder_torque = Max(command.retarder_torque, Clamp(rest, 0.0, retarder_max));
    return command;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_ENDURANCE_H_
