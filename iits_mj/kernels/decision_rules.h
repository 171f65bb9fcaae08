// Rules that decide on lane changes; `controllers.decision.rules` gives their sources.
#ifndef IITS_MJ_KERNELS_DECISION_RULES_H_
#define IITS_MJ_KERNELS_DECISION_RULES_H_

#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels/following.h"

namespace iits {

// The fields of `SafetyConfig`, in its order.
struct Safety {
  double margin, front_time_gap, front_deceleration, rear_time_gap, rear_reaction_time;
  double rear_deceleration, reaction_time, driver_reaction_time, truck_braking, car_braking;
  double driver_braking, entering, sight_behind, unlimited_speed, speeding, abort_factor;

  // `front_gap_needed` and `rear_gap_needed` of controllers/planning/safety.py.
  double FrontGap(double speed, double lead_speed) const {
    const double closing = std::max(speed - lead_speed, 0.0);
    const double comfort = front_time_gap * std::min(speed, lead_speed) +
                           closing * closing / (2.0 * front_deceleration);
    lead_speed = std::max(lead_speed, 0.0);
    const double safe = Stopping(speed, lead_speed, reaction_time, truck_braking, car_braking);
    return margin + std::max(comfort, safe);
  }

  double RearGap(double speed, double follower_speed) const {
    const double closing = std::max(follower_speed - speed, 0.0);
    const double comfort =
        rear_time_gap * std::min(speed, follower_speed) +
        (rear_reaction_time * closing + closing * closing / (2.0 * rear_deceleration));
    const double safe = Stopping(std::max(follower_speed, 0.0), speed, driver_reaction_time,
                                 driver_braking, truck_braking);
    return margin + std::max(comfort, safe);
  }

 private:
  static double Stopping(double speed, double lead_speed, double reaction, double braking,
                         double lead_braking) {
    const double way = speed * reaction + speed * speed / (2.0 * braking);
    return std::max(way - lead_speed * lead_speed / (2.0 * lead_braking), 0.0);
  }
};

// The nearest vehicle at one end of the truck; the gap is infinite without one.
struct Neighbor {
  double gap, speed;
  bool exists() const { return gap < std::numeric_limits<double>::infinity(); }
};

// A lane around the truck: whether the truck may use it, and the least gap of all its vehicles.
struct LaneAround {
  double usable;
  Neighbor leader, follower;
  double least_gap;
};

// What a rule knows. Decisions: -1 is left, 1 is right.
struct Situation {
  double speed, desired, length;
  LaneAround here, left, right;
};

// The drivers that rules expect, the planner's gaps, and the truck's hardest braking.
struct RuleModel {
  Following car, truck;
  Safety safety;
  double hardest_braking;

  // Whether a lane leaves the planner's gaps.
  bool GapsAllow(double speed, const LaneAround& lane) const {
    const Neighbor &leader = lane.leader, &follower = lane.follower;
    if (leader.exists() && leader.gap < safety.FrontGap(speed, leader.speed)) return false;
    return !follower.exists() || follower.gap >= safety.RearGap(speed, follower.speed);
  }

  // The braking that a change asks of the follower in a lane [m/s2]: the interaction term of the
  // IDM of a car. Infinite where the lane does not exist or the planner's gaps are not free.
  double ImposedBraking(double speed, const LaneAround& lane) const {
    if (lane.usable == 0.0 || !GapsAllow(speed, lane)) {
      return std::numeric_limits<double>::infinity();
    }
    const Neighbor& follower = lane.follower;
    return follower.exists() ? car.Interaction(follower.speed, follower.gap, speed) : 0.0;
  }
};

// The parameters of a rule: those of one of the classes in rules.py, in the order of its fields.
struct Rule {
  enum Kind { kKeep, kClearance, kMobil, kLookAhead };

  double kind;
  double parameters[4];

  int Decide(const Situation& at, const RuleModel& model) const {
    if (kind == kKeep || (kind == kClearance && at.here.leader.gap >= parameters[0])) return 0;
    const double keep = kind == kLookAhead ? RollOut(at, at.here.leader, model) : 0.0;
    double best = keep;
    int choice = 0;
    for (const int side : {-1, 1}) {
      const LaneAround& lane = side < 0 ? at.left : at.right;
      if (lane.usable == 0.0) continue;
      if (kind == kClearance) {
        if (lane.least_gap >= parameters[0]) return side;
        continue;
      }
      if (!model.GapsAllow(at.speed, lane)) continue;
      const double worth =
          kind == kMobil ? Incentive(at, lane, model) + (parameters[2] * side - parameters[1])
                         : RollOut(at, lane.leader, model) - parameters[2] + parameters[3] * side;
      if (worth > best) {
        best = worth;
        choice = side;
      }
    }
    return choice;
  }

 private:
  // The truck's gain less the others' loss [m/s2]; minus infinity if it is not safe.
  double Incentive(const Situation& at, const LaneAround& lane, const RuleModel& model) const {
    const double politeness = parameters[0], safe = parameters[3];
    const Neighbor &before = at.here.follower, &after = lane.follower;
    const double own = Own(at, lane.leader, model) - Own(at, at.here.leader, model);
    double loss = 0.0, with_truck, without;
    if (after.exists()) {
      Follower(at, after, lane.leader, model, &with_truck, &without);
      if (with_truck < -safe) return -std::numeric_limits<double>::infinity();
      loss += without - with_truck;
    }
    if (before.exists() && before.gap > 0.0) {
      Follower(at, before, at.here.leader, model, &with_truck, &without);
      loss -= without - with_truck;
    }
    return own - politeness * loss;
  }

  static double Own(const Situation& at, const Neighbor& leader, const RuleModel& model) {
    const double ahead = leader.exists() ? leader.speed : 0.0;
    return model.truck.Idm(at.speed, at.desired, leader.gap, ahead);
  }

  // A follower's accelerations behind the truck and behind the truck's leader.
  static void Follower(const Situation& at, const Neighbor& follower, const Neighbor& leader,
                       const RuleModel& model, double* with_truck, double* without) {
    const double speed = follower.speed, wish = std::max(speed, at.desired);
    const double gap = follower.gap + at.length + leader.gap;
    const double ahead = leader.exists() ? leader.speed : 0.0;
    *with_truck = model.car.Idm(speed, wish, follower.gap, at.speed);
    *without = model.car.Idm(speed, wish, gap, ahead);
  }

  // The distance that the truck drives over the horizon behind a leader [m].
  double RollOut(const Situation& at, const Neighbor& leader, const RuleModel& model) const {
    const double step = parameters[1];
    double speed = at.speed, gap = leader.gap, distance = 0.0;
    const double ahead = leader.exists() ? leader.speed : 0.0;
    for (long i = std::lrint(parameters[0] / step); i > 0; --i) {
      const double a = model.truck.Idm(speed, at.desired, gap, ahead);
      const double after = std::max(0.0, speed + std::max(a, -model.hardest_braking) * step);
      const double moved = 0.5 * (speed + after) * step;
      distance += moved;
      gap += ahead * step - moved;
      speed = after;
    }
    return distance;
  }
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_DECISION_RULES_H_
