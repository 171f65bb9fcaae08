// Steering of one or more axles: actuator at the steering wheel, play of the gear, Ackermann
// geometry, elastic linkage.
#ifndef IITS_MJ_PLUGIN_LAWS_STEERING_H_
#define IITS_MJ_PLUGIN_LAWS_STEERING_H_

#include <cstddef>
#include <vector>

#include "plugin/laws/number.h"

namespace iits {

template <class T>
struct SteeringState {
  T wheel_angle, pitman_angle;  // both at the steering wheel [rad]; pitman is after the play
};

template <class T>
struct Steering {
  // Attributes.
  T ratio, dead_band, angle_max, rate_max, stiffness, time_constant;
  // Of each steered axle: distance ahead of the line on which the vehicle's turning center lies,
  // and distance of the knuckles.
  std::vector<T> wheelbase, track;

  // Angles of an axle's left and right knuckle with a relaxed linkage [rad]. The gear turns the
  // first axle's mean wheel; all wheels turn about one center.
  void Targets(size_t axle, T pitman_angle, T targets[2]) const {
    const T first = tan(pitman_angle / ratio);
    const T tangent = first * (wheelbase[axle] / wheelbase[0]);
    const T half = 0.5 * track[axle] / wheelbase[0] * first;
    targets[0] = atan(tangent / (1 - half));
    targets[1] = atan(tangent / (1 + half));
  }

  // First-order lag within the rate limit, then the play of the gear. A demand that is not finite
  // holds the steering wheel.
  SteeringState<T> Step(T demand, T h, const SteeringState<T>& s) const {
    demand = abs(demand) < kInfinity ? Clamp(demand, -angle_max, angle_max) : s.wheel_angle;
    const T follow = time_constant > 0 ? 1 - exp(-h / time_constant) : T(1);
    const T change = Clamp(follow * (demand - s.wheel_angle), -h * rate_max, h * rate_max);
    const T wheel = s.wheel_angle + change;
    const T half = 0.5 * dead_band;
    return {wheel, Clamp(s.pitman_angle, wheel - half, wheel + half)};
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_STEERING_H_
