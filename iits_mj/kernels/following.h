// Car following and the motion of leaders; `controllers.planning.following` gives the sources.
#ifndef IITS_MJ_KERNELS_FOLLOWING_H_
#define IITS_MJ_KERNELS_FOLLOWING_H_

#include <algorithm>
#include <cmath>

#include "kernels/rounding.h"

namespace iits {

// The fields of `FollowingConfig`, in its order.
struct Following {
  double time_gap, standstill_gap, acceleration_max, deceleration, deceleration_max;
  double preview_deceleration, jerk_max, regain_deceleration, coolness, exponent;

  // The IDM's desired gap s* [m].
  double Wanted(double speed, double lead_speed) const {
    const double closing =
        speed * (speed - lead_speed) / (2.0 * std::sqrt(acceleration_max * deceleration));
    return standstill_gap + std::max(0.0, speed * time_gap + closing);
  }

  // Improved IDM.
  double Idm(double speed, double desired, double gap, double lead_speed) const {
    const double a = acceleration_max, b = deceleration;
    desired = std::max(desired, 0.1);
    const double free = speed <= desired ? a * (1.0 - std::pow(speed / desired, exponent))
                                         : -b * (1.0 - std::pow(desired / speed, a * exponent / b));
    const double ratio = Wanted(speed, lead_speed) / std::max(gap, 0.1);
    if (ratio >= 1.0) return a * (1.0 - Square(ratio)) + std::min(free, 0.0);
    if (speed > desired || free <= 1e-6) return free;
    return free * (1.0 - std::pow(ratio, 2.0 * a / free));
  }

  // The IDM's term of a leader, a (s* / gap)^2 [m/s2]: the braking that it asks for.
  double Interaction(double speed, double gap, double lead_speed) const {
    return acceleration_max * Square(Wanted(speed, lead_speed) / std::max(gap, 0.1));
  }

  // IDM with the constant-acceleration heuristic.
  double Follow(double speed, double desired, double gap, double lead_speed,
                double lead_acceleration) const {
    const double idm = Idm(speed, desired, gap, lead_speed);
    if (!std::isfinite(gap)) return idm;
    // The heuristic stops at the standstill gap, too: the source has the bare gap.
    gap = std::max(gap - standstill_gap, 0.1);
    const double lead = std::min(lead_acceleration, acceleration_max);
    const double closing = speed - lead_speed;
    double heuristic;
    if (lead < 0.0 && lead_speed * closing <= -2.0 * gap * lead) {
      heuristic = Square(speed) * lead / (Square(lead_speed) - 2.0 * gap * lead);
    } else {
      heuristic = lead - Square(std::max(closing, 0.0)) / (2.0 * gap);
    }
    if (idm >= heuristic) return idm;
    const double tempered =
        heuristic + regain_deceleration * std::tanh((idm - heuristic) / regain_deceleration);
    return (1.0 - coolness) * idm + coolness * tempered;
  }
};

// The fields of `Lead`, in its order.
struct Lead {
  double gap, speed, acceleration, until;

  // Writes the distance driven since now [m] and the speed [m/s].
  void At(double time, double* way, double* now) const {
    const double fade = 2.0 * (1.0 - std::exp(-0.5 * time));
    const double faded = speed + acceleration * fade;
    if (faded <= 0.0 && 0.0 < -acceleration) {
      *way = Square(speed) / std::max(-2.0 * acceleration, 1e-3);
      *now = 0.0;
    } else {
      *way = std::max(speed * time + acceleration * 2.0 * (time - fade), 0.0);
      *now = std::max(faded, 0.0);
    }
  }
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_FOLLOWING_H_
