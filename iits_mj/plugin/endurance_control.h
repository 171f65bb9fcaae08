// Who brakes without friction: engine drag first, then the engine brake, then the retarder.
#ifndef IITS_MJ_PLUGIN_ENDURANCE_CONTROL_H_
#define IITS_MJ_PLUGIN_ENDURANCE_CONTROL_H_

#include <algorithm>

#include "plugin/endurance.h"

namespace iits {

// What the driver's pedal and levers ask, each 0 to 1.
struct EnduranceLevers {
  double pedal, engine_brake, retarder;
};

// How engine torque reaches the propeller shaft as the driveline stands now.
struct EnduranceGearing {
  double engine_factor;    // shaft torque per engine torque in overrun; 0: clutch open or changing
  double retarder_factor;  // shaft torque per retarder torque
};

// What engine and retarder are told.
struct EnduranceCommand {
  double pedal;            // accelerator, as far as the brakes allow it, 0 to 1
  double engine_brake;     // of what is available, 0 to 1
  double retarder_torque;  // [N m]
};

// The brakes ask for a whole retarding torque at the shaft, in which the drag counts. What engine
// and engine brake cannot give, in a gear change everything, the retarder is asked for: in a lower
// gear, where the engine can do more, one comes as the other goes, each with its lag. The driver's
// levers ask at least their part; a pressed accelerator turns all off unless the brakes cut it.
struct EnduranceControl {
  double pedal_up;     // accelerator travel below which the engine may brake
  double return_time;  // in which the accelerator comes back after a cut [s]

  // `held_back`, 0 to 1, is how much of the accelerator is withheld.
  EnduranceCommand Update(const EnduranceLevers& levers, const EnduranceDemand& demand,
                          const EnduranceGearing& gearing, double drag, double brake_max,
                          double retarder_max, double h, double* held_back) const {
    const double cut = std::clamp(demand.cut_traction, 0.0, 1.0);
    *held_back = std::max(cut, *held_back - h / return_time);
    EnduranceCommand command = {levers.pedal * (1 - *held_back), 0, 0};
    if (command.pedal >= pedal_up || demand.shaft_torque < 0) return command;
    command.engine_brake = levers.engine_brake;
    command.retarder_torque = levers.retarder * retarder_max;
    if (!(demand.shaft_torque > 0)) return command;
    if (gearing.engine_factor > 0 && brake_max > 0) {
      const double wanted = demand.shaft_torque / gearing.engine_factor - drag;
      command.engine_brake =
          std::max(command.engine_brake, std::clamp(wanted / brake_max, 0.0, 1.0));
    }
    const double engine = gearing.engine_factor * (drag + brake_max);
    const double rest = (demand.shaft_torque - engine) / gearing.retarder_factor;
    command.retarder_torque =
        std::max(command.retarder_torque, std::clamp(rest, 0.0, retarder_max));
    return command;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_ENDURANCE_CONTROL_H_
