// Hydrodynamic retarder on the propeller shaft: torque, filling and emptying, heat.
#ifndef IITS_MJ_PLUGIN_LAWS_RETARDER_H_
#define IITS_MJ_PLUGIN_LAWS_RETARDER_H_

#include "plugin/laws/number.h"

namespace iits {

template <class T>
struct RetarderState {
  T fill;  // share of the torque at full filling, 0 to 1
  T heat;  // of oil and coolant: 0 cold, 1 at steady state with the continuous power
};

template <class T>
struct Retarder {
  // Attributes.
  T torque_max;         // rating [N m]; 0: a truck without retarder
  T full_torque_speed;  // lowest shaft speed with the rated torque [rad/s]
  T power_max, power_continuous;
  T heat_time;    // time constant of the heat [s]
  T derate_heat;  // heat at which the derating begins
  T fill_time, empty_time;

  // Torque of the full retarder at a shaft speed and heat, >= 0; zero in reverse. At constant
  // filling the torque is proportional to the square of the speed; the control limits it to the
  // rating, and at higher speeds to the power of the cooling.
  T Available(T shaft_speed, T heat) const {
    if (shaft_speed <= 0) return 0;
    const T rise = Min(1.0, shaft_speed / full_torque_speed);
    const T cool = Clamp((1 - heat) / (1 - derate_heat), 0.0, 1.0);
    const T power = power_continuous + cool * (power_max - power_continuous);
    return Min(torque_max * rise * rise, power / shaft_speed);
  }

  // Fills towards `wanted` of `available` [N m] and heats by the power of this step. Returns the
  // torque against the shaft's rotation. Heat: d(heat)/dt = (P / P_continuous - heat) / heat_time.
  T Update(T wanted, T available, T shaft_speed, T h, RetarderState<T>* s) const {
    const T target = wanted > 0 && available > 0 ? Min(1.0, wanted / available) : T(0);
    const T lag = target > s->fill ? fill_time : empty_time;
    s->fill += (target - s->fill) * h / (lag + h);
    const T torque = s->fill * available;
    const T power = torque * shaft_speed;
    s->heat += (power / power_continuous - s->heat) * h / (heat_time + h);
    return torque;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_RETARDER_H_
