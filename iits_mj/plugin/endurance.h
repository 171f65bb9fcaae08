// What brake control and powertrain tell each other, as TSC1 and ERC1 do on a truck's bus.
//
// Each reads what the other committed at the end of the last step, so that the order in which
// MuJoCo calls them does not matter. The structures are the first members of the plugins' states.
#ifndef IITS_MJ_PLUGIN_ENDURANCE_H_
#define IITS_MJ_PLUGIN_ENDURANCE_H_

#include <mujoco/mujoco.h>

namespace iits {

// From `iits.air_brake`, all zero: nothing asked.
struct EnduranceDemand {
  // ABS works on the driven wheels: engine brake and retarder shall let go, also of what the
  // driver's levers ask. Any negative torque means this.
  static constexpr double kLetGo = -1;

  double shaft_torque;  // retarding torque wanted at the propeller shaft [N m]
  double cut_traction;  // 1: the engine shall not pull against the brakes
};

// From `iits.powertrain`.
struct EnduranceState {
  double shaft_torque;      // retarding torque at the propeller shaft, all sources, signed [N m]
  double shaft_torque_max;  // what engine drag, engine brake and retarder could give [N m]
  double engine_speed;      // [rad/s]: drives the air compressor
};

// Reads the partner's structure; all zero without a partner (instance < 0).
template <class Message>
Message ReadPartner(const mjModel* m, const mjData* d, int instance) {
  if (instance < 0) return Message();
  return *reinterpret_cast<const Message*>(d->plugin_state + m->plugin_stateadr[instance]);
}

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_ENDURANCE_H_
