// State and laws of the fast world; `controllers.decision.fast_world` describes the model.
#ifndef IITS_MJ_KERNELS_FAST_WORLD_H_
#define IITS_MJ_KERNELS_FAST_WORLD_H_

#include <cstddef>
#include <cstdint>

#include "kernels/decision_rules.h"
#include "kernels/numpy_random.h"

namespace iits {

constexpr int kLanesMost = 3;
constexpr int kFrames = 4, kRows = 9, kFeatures = 6;

// A kind of vehicle and its driver: the numbers of `Kind`, in its order.
struct Driver {
  double length, width, height, minimum_gap, time_headway, acceleration, deceleration;
  double desired_speed_mean, desired_speed_deviation, desired_speed_low;
  double politeness, change_threshold, keep_right_bias, safe_braking;

  // The Intelligent Driver Model; its free term is bounded at -b above the desired speed.
  double Idm(double speed, double desired, double gap, double lead_speed) const {
    const double a = acceleration, b = deceleration;
    const double share = speed / desired, squared = share * share;
    const double free = a * std::max(1.0 - squared * squared, -b / a);
    const double dynamic = speed * (speed - lead_speed) / (2.0 * std::sqrt(a * b));
    const double wanted = minimum_gap + std::max(0.0, speed * time_headway + dynamic);
    const double ratio = wanted / std::max(gap, 0.1);
    return free - a * (ratio * ratio);
  }
};

constexpr int kKinds = 4;
// The traffic treats the truck as an articulated truck.
constexpr int kTruckKind = kKinds - 1;

// Constants that all worlds share: `LAWS` of controllers/decision/fast_world/config.py.
struct Laws {
  RuleModel rules;
  Following truck;
  double pause;            // of the truck between two changes [s]
  double keep_right_time;  // for which a lane must stay free for a truck that keeps right [s]
  Driver kinds[kKinds];
  double shares[kKinds];  // cumulative
  double slow[kKinds];    // whether the limit of trucks applies
  double scale[kFeatures];
};

struct Vehicle {
  std::int64_t serial, lane, kind;  // lane -1 is the lane of a ramp
  double front, speed, acceleration, length, desired, change_time, change_from;
};

// The truck, or the end of a ramp, as the traffic sees it in one lane.
struct Obstacle {
  double front, length, speed;
  std::int64_t lane;
};

// The fields of `RewardTerms`.
struct Terms {
  double change, speed, danger, collision;
};

// One world: `STATE` of controllers/decision/fast_world/config.py has the same fields. The vehicles
// follow, sorted by their front bumpers.
struct World {
  // The trip.
  double traffic_speed, spawn_probability, truck_speed_limit, ramp_probability, ramp_interval;
  std::int64_t keeps_right, lanes, truck_keeps_right;
  double window_behind, window_ahead, sight_behind, sight_ahead, timestep;
  double reference_speed, end, duration, grade_amplitude[2], grade_phase[2];
  double charge_change, charge_danger, charge_speed, charge_collision, discount;
  // The truck's constants.
  double mass, power, drag, rolling, truck_length, front_overhang;
  // The traffic.
  Random random;
  std::int64_t capacity, count, spawned;
  double clock, round_due;
  double wait_ahead[kLanesMost], wait_behind[kLanesMost];
  double most_ahead[kLanesMost], most_behind[kLanesMost];
  // The truck.
  double time, front, speed, acceleration, offset, lateral_speed;
  double change_left, change_lasts, changed_at;
  double speed_max;  // that the truck aims at until the next decision; infinite without one
  std::int64_t lane, source;
  // Totals of the trip, and the last step.
  double distance, driven_time, time_gap_min, loss_integral;
  std::int64_t decisions, changes, refused, dangerous, collisions;
  // The figures of `Quality` in controllers/decision/quality.py; then the vehicle behind the last
  // change, 0 for none, until when it is watched [s], and its hardest braking so far [m/s2], that
  // of a time step.
  double right_time, beside_time;
  std::int64_t imposed_brakings;
  double imposed_deceleration, collision_time_front, collision_time_rear;
  double change_time_gap_front, change_time_gap_rear;
  std::int64_t watched;
  double watched_until, watched_braking;
  Terms total, reward;
  double seconds;
  std::int64_t terminated, truncated;
  float frames[kFrames][kRows][kFeatures];

  Vehicle* vehicles() { return reinterpret_cast<Vehicle*>(this + 1); }
  const Vehicle* vehicles() const { return reinterpret_cast<const Vehicle*>(this + 1); }
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_FAST_WORLD_H_
