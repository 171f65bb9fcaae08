// Losses of gears: an efficiency, or a map of the torque loss.
#ifndef IITS_MJ_PLUGIN_LAWS_GEAR_LOSS_H_
#define IITS_MJ_PLUGIN_LAWS_GEAR_LOSS_H_

#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"

namespace iits {

// Loss of one pair of gears. A map gives the torque loss at the input [N m], rows over the speed of
// the input [rad/s] and columns over its torque [N m], which is negative when it brakes; with
// straight lines beyond its edges and never below zero, as VECTO reads such maps.
template <class T>
struct GearLoss {
  T efficiency;
  const Map<T>* map;  // null: by the efficiency

  struct BrakingLine {
    T efficiency, loss;
  };

  T Loss(T torque, T speed) const { return Max(0.0, map->Extrapolated(speed, torque)); }

  // Torque behind the gears, without their ratio, at a speed well above zero. For predictions: an
  // efficiency counts as that of a driving torque.
  T Behind(T torque, T speed) const {
    return map ? torque - Loss(torque, speed) : torque * efficiency;
  }

  // The input torque that gives a torque behind the gears: inverse of Behind. The loss changes by
  // some percent of the torque, so that three steps leave less than 1e-4 of the loss.
  T Before(T torque, T speed) const {
    if (!map) return torque / efficiency;
    T input = torque;
    for (int i = 0; i < 3; ++i) input = torque + Loss(input, speed);
    return input;
  }

  // A braking torque T at the input brakes with T / efficiency + loss behind the gears; a straight
  // line from 0 to `torque`.
  BrakingLine Braking(T torque, T speed) const {
    if (!map) return {efficiency, 0};
    const T idle = Loss(T(0), speed);
    return {torque > 0 ? torque / (torque + Loss(-torque, speed) - idle) : T(1), idle};
  }

  // Torque behind the gears at any speed. The loss opposes the flow of power in both directions. It
  // changes its sign over `reversal` [rad/s] of `turning`, a speed with the sign of the input's: a
  // loss torque never drives a truck at rest.
  T After(T torque, T speed, T turning, T reversal) const {
    if (map) {
      const T along = speed < 0 ? -torque : torque;
      return torque - Clamp(turning / reversal, -1.0, 1.0) * Loss(along, abs(speed));
    }
    if (torque * speed >= 0) return torque * efficiency;
    const T back = Min(1.0, abs(speed) / reversal);
    return torque * (efficiency + back * (1 / efficiency - efficiency));
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_GEAR_LOSS_H_
