// Endurance brakes: the messages between brakes and powertrain, as TSC1 and ERC1 on a truck's bus,
// and the distribution of a demand among engine drag, engine brake and retarder.
#ifndef IITS_MJ_PLUGIN_LAWS_ENDURANCE_H_
#define IITS_MJ_PLUGIN_LAWS_ENDURANCE_H_

#include "plugin/laws/number.h"

namespace iits {

// From the brakes to the powertrain; all zero: no demand.
template <class T>
struct EnduranceDemand {
  // Any negative torque: ABS is active on the driven wheels, so that engine brake and retarder
  // release, even against the driver's levers.
  static constexpr double kRelease = -1;

  T shaft_torque;  // demanded retarding torque at the propeller shaft [N m]
  T cut_traction;  // share of the accelerator to cut, by the brakes or by traction control
  T traction_cut;  // 1: by traction control
  T drag_relief;   // by drag-torque control, 0 to 1; see DriveSlipControl

  // Relief without engine brake and retarder, at which the engine overcomes its own drag.
  static constexpr double kNoDrag = 0.75;
};

// From the powertrain to the brakes.
template <class T>
struct EnduranceState {
  T shaft_torque;      // retarding torque at the propeller shaft, all sources, signed [N m]
  T shaft_torque_max;  // greatest possible torque of engine drag, engine brake and retarder [N m]
  T engine_speed;      // [rad/s]: drives the air compressor
};

// Positions of the driver's pedal and levers, each 0 to 1.
template <class T>
struct EnduranceLevers {
  T pedal, engine_brake, retarder;
};

// Transmission of engine and retarder torque to the propeller shaft in the present gear.
template <class T>
struct EnduranceGearing {
  T engine_factor;    // shaft torque per engine torque in overrun; 0: clutch open or changing gear
  T retarder_factor;  // shaft torque per retarder torque
  T loss;             // shaft torque of losses without any torque of engine and retarder [N m]
};

// Commands to engine and retarder.
template <class T>
struct EnduranceCommand {
  T pedal;            // accelerator, limited by the brakes, 0 to 1
  T engine_brake;     // share of the available torque, 0 to 1
  T retarder_torque;  // [N m]
};

// The brakes demand a total retarding torque at the shaft, which includes the drag. The retarder
// gives the part that engine drag and engine brake cannot give, and all of it in a gear change. In
// a lower gear the engine can give more: the engine brake rises while the retarder falls, each with
// its lag. The driver's levers demand at least their share; a pressed accelerator switches engine
// brake and retarder off, unless the brakes cut the accelerator.
template <class T>
struct EnduranceControl {
  T pedal_up;     // accelerator travel below which the engine may brake
  T return_time;  // of the accelerator after a cut [s]

  // `drag` is that of engine and auxiliaries; `held_back`, 0 to 1, the withheld part of the
  // accelerator.
  EnduranceCommand<T> Update(const EnduranceLevers<T>& levers, const EnduranceDemand<T>& demand,
                             const EnduranceGearing<T>& gearing, T drag, T brake_max,
                             T retarder_max, T h, T* held_back) const {
    const T cut = Clamp(demand.cut_traction, 0.0, 1.0);
    *held_back = Max(cut, *held_back - h / return_time);
    EnduranceCommand<T> command = {levers.pedal * (1 - *held_back), 0, 0};
    if (command.pedal >= pedal_up || demand.shaft_torque < 0) return command;
    command.engine_brake = levers.engine_brake;
    command.retarder_torque = levers.retarder * retarder_max;
    if (demand.shaft_torque > 0)
      Brake(demand.shaft_torque, gearing, drag, brake_max, retarder_max, &command);
    if (demand.drag_relief > 0) {
      const T left = Max(0.0, 1 - 2 * demand.drag_relief);
      command.engine_brake *= left;
      command.retarder_torque *= left;
    }
    return command;
  }

  // Brake torque of the engine that drag-torque control demands, from its drag to the opposite.
  static T PullTorque(const EnduranceDemand<T>& demand, T drag) {
    return (4 * Clamp(demand.drag_relief, 0.5, 1.0) - 3) * drag;
  }

 private:
  void Brake(T shaft_torque, const EnduranceGearing<T>& gearing, T drag, T brake_max,
             T retarder_max, EnduranceCommand<T>* command) const {
    if (gearing.engine_factor > 0 && brake_max > 0) {
      const T wanted = (shaft_torque - gearing.loss) / gearing.engine_factor - drag;
      command->engine_brake = Max(command->engine_brake, Clamp(wanted / brake_max, 0.0, 1.0));
    }
    const T engine = gearing.engine_factor * (drag + brake_max) + gearing.loss;
    const T rest = (shaft_torque - engine) / gearing.retarder_factor;
    command->retarder_torque = Max(command->retarder_torque, Clamp(rest, 0.0, retarder_max));
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_ENDURANCE_H_
