// Steering of one or more axles: actuator at the steering wheel, play of the gear, Ackermann
// geometry, elastic linkage.
#ifndef IITS_MJ_PLUGIN_LAWS_STEERING_H_
#define IITS_MJ_PLUGIN_LAWS_STEERING_H_

#include <cstddef>
#include <vector>

#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"

namespace iits {

template <class T>
struct SteeringState {
  T wheel_angle, pitman_angle;  // both at the steering wheel [rad]; pitman is after the play
};

// What a steered wheel does at its kingpin.
template <class T>
struct KingpinLoad {
  T forward, lateral, vertical, aligning;  // of the tire, ISO 8855 [N], [N m]
  T angle, rate;                           // of the knuckle, left positive [rad], [rad/s]
  T speed;                                 // of the rolling wheel [m/s]
  T side;                                  // 1 left, -1 right
};

template <class T>
struct Steering {
  // Attributes.
  T ratio, dead_band, angle_max, rate_max, stiffness, time_constant;
  // Of each steered axle: distance ahead of the line on which the vehicle's turning center lies,
  // and distance of the knuckles.
  std::vector<T> wheelbase, track;
  // Of the steering-wheel torque; they have no effect on the motion.
  T caster_trail = 0, scrub_radius = 0, kingpin_inclination = 0, scrub_friction = 0, scrub_arm = 0;
  T friction = 0;            // at the steering wheel [N m]
  Curve<T> assistance = {};  // of the boost, at the kingpins, over the steering-wheel torque [N m]

  // Angles of an axle's left and right knuckle with a relaxed linkage [rad]. The gear turns the
  // first axle's mean wheel; all wheels turn about one center.
  void Targets(size_t axle, T pitman_angle, T targets[2]) const {
    const T first = tan(pitman_angle / ratio);
    const T tangent = first * (wheelbase[axle] / wheelbase[0]);
    const T half = 0.5 * track[axle] / wheelbase[0] * first;
    targets[0] = atan(tangent / (1 - half));
    targets[1] = atan(tangent / (1 + half));
  }

  // Turn of an axle's left and right knuckle per turn of the steering wheel [1].
  void Leverage(size_t axle, T pitman_angle, T leverage[2]) const {
    const T first = tan(pitman_angle / ratio), slope = (1 + first * first) / ratio;
    const T scale = wheelbase[axle] / wheelbase[0], half = 0.5 * track[axle] / wheelbase[0];
    for (int side : {0, 1}) {
      const T below = side ? 1 + half * first : 1 - half * first;
      const T tangent = scale * first / below;
      leverage[side] = slope * scale / (below * below * (1 + tangent * tangent));
    }
  }

  // Moment of the road about a kingpin [N m], left positive. Aligning moment and side force, which
  // acts behind the kingpin by the caster trail; brake or drive force at the scrub radius; lift of
  // the axle by the inclined kingpin; scrubbing of a tire that turns on the spot (Barton and
  // Fieldhouse, Automotive Chassis Engineering, 2.17), which rolling takes away.
  T KingpinMoment(const KingpinLoad<T>& at) const {
    constexpr double kCreep = 1e-3;  // [m/s]: numerical
    const T turning = at.rate * scrub_arm;
    const T slide = turning / sqrt(turning * turning + at.speed * at.speed + kCreep * kCreep);
    const T lift = scrub_radius * sin(kingpin_inclination) * cos(kingpin_inclination);
    return at.aligning - caster_trail * at.lateral - at.side * scrub_radius * at.forward -
           at.vertical * (lift * sin(at.angle) + scrub_friction * scrub_arm * slide);
  }

  // Torque of the driver [N m], left positive, that carries `load` [N m] without assistance while
  // the steering wheel turns at `rate` [rad/s]. The valve opens with the driver's torque; the
  // friction opposes the rate.
  T WheelTorque(T load, T rate) const {
    constexpr double kSlowest = 0.02;  // [rad/s] over which the friction changes its sign
    const T weight = abs(load);
    T torque = weight;
    if (!assistance.x.empty()) {
      size_t i = 1;
      const auto carried = [this](size_t k) { return assistance.x[k] + assistance.y[k] / ratio; };
      while (i + 1 < assistance.x.size() && carried(i) < weight) ++i;
      const T share = (weight - carried(i - 1)) / (carried(i) - carried(i - 1));
      torque = weight > carried(i)
                   ? weight - assistance.y[i] / ratio
                   : assistance.x[i - 1] + share * (assistance.x[i] - assistance.x[i - 1]);
    }
    return (load < 0 ? -torque : torque) +
           friction * rate / sqrt(rate * rate + kSlowest * kSlowest);
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
