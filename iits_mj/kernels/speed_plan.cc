// Speed over the coming seconds, step by step; `controllers.planning.speed_plan` describes it.
#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels/following.h"
#include "kernels/interpolation.h"
#include "kernels/kernels.h"

using iits::Following;
using iits::Lead;
using iits::Square;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// The plan uses the cap this far ahead [s]: far for a smooth onset, near for an exact end.
constexpr double kFar = 1.0, kNear = 0.4;
// Below this speed the plan of a stop uses the distance that is left: with a look-ahead the truck
// would creep towards it without end [m/s].
constexpr double kLastSpeed = 2.0;
// Braking of a truck that has come to rest at a stop [m/s2].
constexpr double kHoldDeceleration = 1.2;
// Room that counts where none is left [m]: below 0.75 m/s nothing is an emergency.
constexpr double kLeastRoom = 0.1;

// Bound on the speed over stations `step` apart.
struct Cap {
  const double* speed;
  long last;
  double first, per_step;

  double At(double station) const {
    const double position = (station - first) * per_step;
    if (position <= 0.0) return speed[0];
    if (position >= static_cast<double>(last)) return speed[last];
    const long row = static_cast<long>(position);
    return speed[row] + (position - static_cast<double>(row)) * (speed[row + 1] - speed[row]);
  }
};

// A stop of the steer axle: its station, and the deceleration towards it.
struct Stop {
  double station, braking, near;

  // Bound on the speed at a station.
  double Bound(double place) const {
    return std::sqrt(2.0 * braking * std::max(station - place, 0.0));
  }

  // Acceleration over the last meters, which ends in finite time: the needed constant deceleration,
  // v^2 / (2 left), if it exceeds 0.8 of the wanted one; positive if it is less than half of it.
  double LastMeters(double v, double place, double acceleration_max) const {
    const double left = station - place;
    if (left < 0.05) return -kHoldDeceleration;
    const double needed = v * v / (2.0 * left), share = needed / braking;
    if (share < 0.5) return acceleration_max * (1.0 - 2.0 * share);
    return share > 0.8 ? -needed : -0.8 * braking * (share - 0.5) / 0.3;
  }
};

// Acceleration that every leader allows. On the free road the plan follows the cap exactly, also
// where it rises: the free term of car following would lag a rising reference by v / (4 a), some
// 5 s. Behind a leader the desired speed of that term is high enough not to lag either: the free
// term, a (1 - (v / desired)^n), is no less than `to_cap`.
double Behind(const Following& following, const Lead* leads, long count, double v, double way,
              double time, double cap, double to_cap) {
  const double share = std::min(std::max(to_cap / following.acceleration_max, 0.0), 0.9);
  const double desired = std::max(cap, v / std::pow(1.0 - share, 1.0 / following.exponent));
  double wanted = kInfinity;
  for (const Lead* lead = leads; lead < leads + count; ++lead) {
    if (time > lead->until) continue;
    double lead_way, lead_speed;
    lead->At(time, &lead_way, &lead_speed);
    const double fading = lead_speed > 0.0 ? lead->acceleration * std::exp(-0.5 * time) : 0.0;
    const double gap = lead->gap + lead_way - way;
    wanted = std::min(wanted, following.Follow(v, desired, gap, lead_speed, fading));
  }
  return wanted;
}

}  // namespace

// Writes the greatest comfortable speed at `count` stations: the least of the wanted speed, the
// lane's limit and the curve speed, approached at the deceleration.
//   road: curvature of the reference line at the stations; offset: of the path from it.
//   curve_acceleration: lateral acceleration that bounds the speed in curves.
// Returns 1 if a speed is not a number, else 0.
IITS_KERNEL long iits_speed_cap(long count, const double* station, const double* offset,
                                const double* limit, const double* wanted, const double* road,
                                double curve_acceleration, double deceleration, double* cap) {
  long unknown = 0;
  auto curvature = [&](long k) {
    const double aside = std::isfinite(offset[k]) ? offset[k] : 0.0;
    return std::fabs(road[k] / std::max(1.0 - road[k] * aside, 0.2));
  };
  double before = curvature(0), here = before;
  for (long k = 0; k < count; ++k) {
    const double after = k + 1 < count ? curvature(k + 1) : here;
    // The truck must reach the speed before the bend begins: the sharpest of three counts.
    const double sharpest = std::max(std::max(before, here), after);
    const double curve = std::sqrt(curve_acceleration / std::max(sharpest, 1e-6));
    cap[k] = std::min(std::min(wanted[k], limit[k]), curve);
    unknown |= std::isnan(wanted[k]) || std::isnan(limit[k]);
    before = here;
    here = after;
  }
  double ahead = kInfinity;
  for (long k = count - 1; k >= 0; --k) {
    const double bound = std::min(cap[k], 100.0), fall = 2.0 * deceleration * station[k];
    ahead = std::min(ahead, bound * bound + fall);
    cap[k] = std::sqrt(std::max(ahead - fall, 0.0));
  }
  return unknown;
}

// Reference speed at `count` even stations, with constant acceleration between its nodes.
//   nodes, square: stations of the nodes, and squares of their speeds.
//   here: station of the truck; least: square of the lowest speed of its launch, negative for none.
//   gain: rise of the launch's v^2 with the way; reach: distance ahead up to which it may raise the
//   reference, at most to the greatest reference there.
IITS_KERNEL void iits_reference(long count, const double* station, long nodes, const double* node,
                                const double* square, double here, double least, double gain,
                                double reach, double* found) {
  const iits::Abscissae places(node, nodes);
  double most = 0.0;
  long near = 0;
  for (long k = 0; k < count; ++k) {
    near = places.Find(station[k], near);
    found[k] = places.Value(square, station[k], near);
    const double ahead = station[k] - here;
    if (ahead >= 0.0 && ahead < reach) most = std::max(most, found[k]);
  }
  const double step = station[1] - station[0];
  for (long k = 0; k < count; ++k) {
    if (least >= 0.0) {
      const double launch = least + gain * std::max(station[k] - here, step);
      found[k] = std::max(found[k], std::min(launch, most));
    }
    found[k] = std::sqrt(found[k]);
  }
}

// Acceleration that the power allows against rolling resistance, slope and air.
IITS_KERNEL double iits_power_acceleration(double speed, double mass, double power,
                                           double rolling_and_slope, double drag) {
  const double resistance = rolling_and_slope + drag * Square(speed) / mass;
  const double found = power / (mass * (speed > 3.0 ? speed : 3.0)) - resistance;
  return found > 0.05 ? found : 0.05;
}

// Greatest deceleration that a leader requires now.
IITS_KERNEL double iits_most_urgent(const Lead* leads, long count, double speed,
                                    double reaction_time, double margin) {
  double worst = 0.0;
  for (const Lead* lead = leads; lead < leads + count; ++lead) {
    double way, lead_speed;
    lead->At(reaction_time, &way, &lead_speed);
    const double gap = lead->gap + way - speed * reaction_time;
    const double closing = speed - lead_speed;
    double needed = 0.0;
    if (closing > 0.0) needed = Square(closing) / (2.0 * std::max(gap - margin, kLeastRoom));
    if (lead->acceleration < -1.0) {
      // Both stop: the leader's stopping distance adds to the room.
      const double room = gap - margin + Square(lead_speed) / (-2.0 * lead->acceleration);
      needed = std::max(needed, Square(speed) / (2.0 * std::max(room, kLeastRoom)));
    }
    worst = std::max(worst, needed);
  }
  return worst;
}

// Writes station, speed and acceleration, `steps` + 1 of each, one row after the other.
//   cap: `cap_count` bounds on the speed from station `cap_first` on, `cap_step` apart.
//   emergency: deceleration of emergency braking, 0 for none.
//   hold_reach: distance to the stop within which a truck at rest stays.
IITS_KERNEL void iits_roll_out(const Following* config, double station, double speed,
                               double acceleration, const double* cap, long cap_count,
                               double cap_first, double cap_step, const Lead* leads,
                               long lead_count, double mass, double power, double rolling_and_slope,
                               double drag, double stop_station, double stop_deceleration,
                               double hold_reach, double emergency, long hold, long steps,
                               double step, double* rows) {
  const Following& following = *config;
  const Cap bound{cap, cap_count - 1, cap_first, 1.0 / cap_step};
  double fastest_cap = cap[0];
  for (long i = 1; i < cap_count; ++i) fastest_cap = std::max(fastest_cap, cap[i]);
  // Before `near` the stop does not bound the speed.
  const double near = stop_station - Square(fastest_cap) / (2.0 * stop_deceleration);
  const Stop stop{stop_station, stop_deceleration, near};
  auto cap_at = [&](double place, bool creeping) {
    const double here = bound.At(place);
    return place > stop.near && !creeping ? std::min(here, stop.Bound(place)) : here;
  };
  const double down = following.jerk_max * step, up = 0.5 * (following.jerk_max * step);
  const double least = -following.deceleration_max, most = following.acceleration_max;
  double s = station, v = std::max(speed, 0.0), a = acceleration;
  for (long k = 0; k <= steps; ++k) {
    const double time = static_cast<double>(k) * step;
    if (k > 0) {
      const double moved = v * step + 0.5 * a * step * step, next = v + a * step;
      // If the truck stops within the step, it moves only until then.
      s += next > 0.0 || a >= 0.0 ? (moved > 0.0 ? moved : 0.0) : v * v / (-2.0 * a);
      v = next > 0.0 ? next : 0.0;
    }
    double wanted = -emergency;
    hold = hold || (k > 0 && v <= 0.0 && s > stop.station - hold_reach);
    if (!(emergency > 0.0)) {
      const bool slow = v < kLastSpeed;
      double to_cap = (cap_at(s + v * kFar, slow) - v) / kFar;
      const double soon = (cap_at(s + v * kNear, slow) - v) / kNear;
      to_cap = soon < to_cap ? soon : to_cap;
      if (hold) {
        to_cap = -kHoldDeceleration;
      } else if (slow && s > stop.near) {
        to_cap = std::min(to_cap, stop.LastMeters(v, s, most));
      }
      wanted = to_cap < most ? to_cap : most;
      if (lead_count > 0) {
        const double here = cap_at(s, false);
        wanted = std::min(wanted,
                          Behind(following, leads, lead_count, v, s - station, time, here, to_cap));
      }
      wanted = wanted > least ? wanted : least;
      const double left = iits_power_acceleration(v, mass, power, rolling_and_slope, drag);
      wanted = left < wanted ? left : wanted;
      const double slowest = a - down, fastest = a + up;
      wanted = wanted < slowest ? slowest : wanted > fastest ? fastest : wanted;
    }
    a = wanted;
    // At a hold the brakes stay on: the truck may come to rest later than the plan.
    if (v <= 0.0 && a < 0.0 && !(hold && speed > 0.0)) a = 0.0;
    rows[k] = s;
    rows[steps + 1 + k] = v;
    rows[2 * (steps + 1) + k] = a;
  }
}
