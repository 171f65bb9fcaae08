// Couplings: roll moment of a fifth wheel's plate and lash or of a turntable, friction in yaw.
#ifndef IITS_MJ_PLUGIN_LAWS_FIFTH_WHEEL_H_
#define IITS_MJ_PLUGIN_LAWS_FIFTH_WHEEL_H_

#include "plugin/laws/number.h"

namespace iits {

template <class T>
struct FifthWheel {
  // Attributes.
  T roll_stiffness, roll_damping, roll_lash, plate_width, kingpin_load, yaw_friction;
  int turntable = 0;  // 1: a bolted ring, which neither lifts nor has a lash

  // The kingpin load presses the trailer onto the plate, which resists roll stiffly until the load
  // has moved to the plate's edge. From this moment on, the plate opens through the lash, and then
  // the locked kingpin carries the additional moment. A turntable stays closed under any moment.
  T RollMoment(T roll, T rate) const {
    if (turntable) return -(roll_stiffness * roll + roll_damping * rate);
    const T lift_moment = 0.5 * plate_width * kingpin_load;  // at which the plate opens
    const T elastic = roll_stiffness * abs(roll);
    const T open = elastic - lift_moment;  // as if there were no lash
    const T beyond = open - roll_stiffness * roll_lash;
    const T moment = open > 0 ? lift_moment + Max(0.0, beyond) : elastic;
    const bool touching = open <= 0 || beyond > 0;
    // Plate and kingpin can push but not pull, whatever the damping.
    const T damping = touching ? roll_damping * (roll < 0 ? -rate : rate) : T(0);
    const T total = open <= 0 ? moment + damping : Max(0.0, moment + damping);
    return roll < 0 ? total : -total;
  }

  // Elasto-plastic friction: returns the moment in yaw and advances the wind-up [rad] by h.
  T YawMoment(T rate, T h, T* wind_up) const {
    constexpr double kWindUp = 0.002;  // [rad] of yaw to full friction
    *wind_up = Clamp(*wind_up + h * rate, -kWindUp, kWindUp);
    return -(yaw_friction * *wind_up / kWindUp);
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_FIFTH_WHEEL_H_
