// Electronic brake control: from XBR demand and brake pedal to the supply pressure of each circuit
// and to the torque demand on the endurance brakes.
#ifndef IITS_MJ_PLUGIN_LAWS_BRAKE_CONTROL_H_
#define IITS_MJ_PLUGIN_LAWS_BRAKE_CONTROL_H_

#include <vector>

#include "plugin/laws/dead_time.h"
#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"

namespace iits {

// Load sensing: shares of a braking force among the circuits, and their pressures. The shares are
// tables over the deceleration for a light and a heavy vehicle, interpolated by the vehicle's mass.
template <class T>
struct BrakeDistribution {
  // Attributes; shares row by row, a column per circuit.
  std::vector<T> demand, light, heavy;
  T mass_light, mass_heavy, push_out;
  // Braking force per pressure above push-out [N/Pa], the sum of the circuit's wheels.
  T slope[kCircuits] = {};

  // Pressures [Pa] for the braking force `friction` [N], while the propeller shaft gives
  // `shaft_force` at the driven wheels, which then need less friction.
  void Pressures(T friction, T shaft_force, T deceleration, T mass, T pressure[kCircuits]) const {
    T fraction;
    const size_t row = kCircuits * FindInterval(demand, deceleration, &fraction);
    const T load = Clamp((mass - mass_light) / (mass_heavy - mass_light), 0.0, 1.0);
    auto between = [&fraction, row](const std::vector<T>& table, int i) {
      return table[row + i] + fraction * (table[row + kCircuits + i] - table[row + i]);
    };
    T share[kCircuits], sum = 0;
    for (int i = 0; i < kCircuits; ++i) {
      const T light_share = between(light, i), heavy_share = between(heavy, i);
      share[i] = slope[i] > 0 ? light_share + load * (heavy_share - light_share) : T(0);
      sum += share[i];
    }
    // The braking of the shaft is deducted from the driven wheels' share of the total.
    const T total = friction + Max(0.0, shaft_force);
    if (sum > 0 && total > 0 && slope[kDrive] > 0) {
      const T spared = Max(0.0, shaft_force) / total * sum;
      const T left = Max(0.0, share[kDrive] - spared);
      sum += left - share[kDrive];
      share[kDrive] = left;
    }
    for (int i = 0; i < kCircuits; ++i) {
      const T force = sum > 0 ? friction * share[i] / sum : T(0);
      pressure[i] = slope[i] > 0 ? push_out + force / slope[i] : T(0);
    }
  }
};

template <class T>
struct BrakeControlState {
  T initialized;
  T supply[kCircuits];  // pressure at the outlet of the supply valve [Pa]
  // A model of the brakes behind it: pressure in the chambers, pressure behind their hysteresis
  // [Pa], and the share of the hysteresis by which the supply is lowered to compensate for it.
  T chamber[kCircuits], effective[kCircuits], lowering[kCircuits];
  T speed;             // of the vehicle, low-passed [m/s]
  T reference[2];      // demand behind the lag of the brakes, then behind the filter [m/s2]
  T xbr;               // XBR demand with a gradual decrease [m/s2]
  T trim;              // addition of the deceleration control to the demand [m/s2]
  T shaft, shaft_max;  // present and greatest force of the propeller shaft, low-passed [N]
  T asked;             // demand on the propeller shaft [N]
  T holding;           // 1: the brakes hold the vehicle at standstill
  T hold_time;         // since the demand ended, while holding [s]
};

template <class T>
struct BrakeDemand {
  enum XbrMode { kOff = 0, kAddition, kMaximum };                    // SPN 2916
  enum EbiMode { kFrictionOnly = 0, kEnduranceOnly, kIntegration };  // SPN 2914
  T xbr;    // demanded deceleration, >= 0, 0 if XBR is off [m/s2]
  T pedal;  // of the driver, 0 to 1
  XbrMode xbr_mode;
  EbiMode ebi_mode;
  T speed;             // of the vehicle, forward [m/s]
  T mass, gravity;     // of the whole vehicle [kg]; [m/s2]
  bool abs_active;     // on any wheel
  bool abs_on_drive;   // on a driven wheel
  T shaft_force;       // present braking force of the propeller shaft, signed [N]
  T shaft_force_max;   // its greatest possible braking force [N]
  T uphill_torque;     // brake torque that keeps the vehicle from rolling back [N m]
  const T* reservoir;  // pressure of each circuit's reservoir [Pa]
};

// Demands on the powertrain.
template <class T>
struct BrakeEffort {
  T shaft_force;  // demanded braking force of the propeller shaft, >= 0 [N]
  bool active;    // a driver or a controller demands braking
};

template <class T>
struct BrakeControl {
  using Demand = BrakeDemand<T>;
  using State = BrakeControlState<T>;

  BrakeDistribution<T> distribution;
  // Attributes.
  T rise_rate, fall_rate, pressure_max, release_rate;
  T pedal_deceleration, rolling_resistance;
  T filter_time, trim_gain, trim_max, trim_share, trim_speed_min;
  T shaft_speed_off, shaft_speed_on, endurance_rate;
  T hysteresis, hysteresis_time;
  T hold_speed, hold_deceleration, hold_release_speed, hold_time_max, hold_uphill;
  // From the wheels.
  T response_time = 0;  // from the supply valve to the brake, mean [s]
  T spin_mass = 0, radius_sum = 0;
  int wheels = 0;

  // Adds a wheel: its circuit, radius [m], spin inertia [kg m2], torque per pressure [N m/Pa].
  void AddWheel(int circuit, T radius, T inertia, T torque_per_pressure) {
    distribution.slope[circuit] += torque_per_pressure / radius;
    spin_mass += inertia / (radius * radius);
    radius_sum += radius;
    ++wheels;
  }

  // Advances the supply pressures by h.
  BrakeEffort<T> Update(const Demand& demand, T h, State* s) const {
    if (s->initialized == 0) {
      s->initialized = 1;
      s->speed = demand.speed;
      s->shaft = demand.shaft_force;
      s->shaft_max = demand.shaft_force_max;
    }
    const T difference = demand.speed - s->speed;
    s->speed += difference * h / (filter_time + h);
    const T deceleration = -difference / (filter_time + h);

    const Level level = Arbitrate(demand, h, s);
    Hold(demand, level.total > 0, h, s);
    const Targets targets = Blend(demand, level, ShaftForce(demand, h, s), *s);
    T supplied = 1;  // least share of a circuit's set point that its supply has reached
    for (int i = 0; i < kCircuits; ++i) {
      const T target = targets.pressure[i];
      Supply(i, target, h, s);
      if (target > 0) {
        supplied = Min(supplied, Min(1.0, (s->supply[i] + s->lowering[i] * hysteresis) / target));
      }
    }
    Trim(demand, level.total, deceleration, targets, supplied, h, s);
    BrakeEffort<T> effort = targets.effort;
    if (demand.ebi_mode == demand.kIntegration) {
      // The demand rises no faster than friction can fall, from zero after a gear change.
      const T limit = Min(s->asked, demand.shaft_force_max) + endurance_rate * demand.mass * h;
      effort.shaft_force = Min(effort.shaft_force, Max(0.0, limit));
    }
    s->asked = effort.shaft_force;
    return effort;
  }

 private:
  static constexpr double kPedalMin = 0.01;  // up to this travel, the pedal counts as released
  static constexpr double kNear = 0.1;       // share of the hysteresis that sets no direction

  struct Level {  // of the demands [m/s2]
    T driver, total;
  };
  struct Targets {
    T pressure[kCircuits];
    BrakeEffort<T> effort;
    bool limited;  // the brakes cannot give more
    bool idle;     // the brakes cannot give less
  };

  // Combines driver and XBR by J1939-71, SPN 2916. In motion, the XBR part ends gradually.
  Level Arbitrate(const Demand& demand, T h, State* s) const {
    const T asked = demand.xbr_mode == demand.kOff ? T(0) : demand.xbr;
    const bool moving = abs(demand.speed) > hold_speed;
    s->xbr = moving ? Max(asked, s->xbr - release_rate * h) : asked;
    const T driver = demand.pedal > kPedalMin ? demand.pedal * pedal_deceleration : T(0);
    const bool addition = demand.xbr_mode == demand.kAddition;
    return {driver, addition ? driver + s->xbr : Max(driver, s->xbr)};
  }

  // The brakes hold a vehicle at standstill during the demand; on an upgrade also afterwards, until
  // the driveline carries it or drives it backwards, or the hill-hold time ends.
  void Hold(const Demand& demand, bool active, T h, State* s) const {
    if (active) {
      if (abs(demand.speed) < hold_speed) s->holding = 1;
      s->hold_time = 0;
    } else if (s->holding != 0) {
      s->hold_time += h;
      const T hill = demand.mass * hold_uphill;  // force that rolls the vehicle back [N]
      const bool carried = demand.uphill_torque < hill * radius_sum / Max(wheels, 1);
      const bool reversing = demand.shaft_force > hill;
      if (carried || reversing || s->hold_time > hold_time_max) s->holding = 0;
    }
    if (abs(demand.speed) > hold_release_speed) s->holding = 0;
  }

  // Braking force for a deceleration on a level road, less rolling resistance; it includes the
  // inertia of the wheels.
  T Force(const Demand& demand, T deceleration) const {
    const T rolling = rolling_resistance * demand.mass * demand.gravity;
    return Max(0.0, (demand.mass + spin_mass) * deceleration - rolling);
  }

  // Braking force of the shaft after the response time of friction: its present and its greatest
  // force, both extrapolated by their recent change. Thus friction acts from the start of a gear
  // change, before a retarder fades out, and ends as soon as a retarder has filled.
  T ShaftForce(const Demand& demand, T h, State* s) const {
    auto ahead = [this, &h](T now, T* past) {
      const T change = now - *past;
      *past += change * h / (response_time + h);
      return now + change;
    };
    const T force = ahead(demand.shaft_force, &s->shaft);
    return Min(force, Max(0.0, ahead(demand.shaft_force_max, &s->shaft_max)));
  }

  // Shares the force. The shaft always brakes (engine drag); friction gives the rest.
  Targets Blend(const Demand& demand, const Level& level, T shaft_force, const State& s) const {
    Targets t = {};
    t.effort.active = level.total > 0;
    const T wanted = t.effort.active ? Max(0.0, level.total + s.trim) : T(0);
    T friction = 0, force = 0;
    const bool endurance_only = demand.ebi_mode == demand.kEnduranceOnly && s.xbr > 0;
    if (t.effort.active) {
      force = Force(demand, wanted);
      friction = Max(0.0, force - shaft_force);
      if (endurance_only) friction = Min(friction, Force(demand, level.driver));
      t.idle = friction <= 0;
      // Endurance brakes act on one axle group without slip control: off while ABS is active. Near
      // walking speed the driveline will open: friction takes over before, if it is allowed.
      if (demand.ebi_mode != demand.kFrictionOnly && !demand.abs_active) {
        const T range = (demand.speed - shaft_speed_off) / (shaft_speed_on - shaft_speed_off);
        const bool integrated = demand.ebi_mode == demand.kIntegration;
        t.effort.shaft_force = integrated ? force * Clamp(range, 0.0, 1.0) : force;
        t.limited = endurance_only && level.driver == 0 && force > demand.shaft_force_max;
      }
    }
    const T held = s.holding != 0 ? Force(demand, hold_deceleration) : T(0);
    const bool prepared = t.effort.active && !(endurance_only && level.driver == 0);
    if (!prepared && held == 0) return t;
    distribution.Pressures(Max(friction, held), shaft_force, wanted, demand.mass, t.pressure);
    for (int i = 0; i < kCircuits; ++i) {
      const T available = Min(pressure_max, demand.reservoir[i]);
      t.limited = t.limited || t.pressure[i] > available;
      t.pressure[i] = Min(t.pressure[i], available);
    }
    return t;
  }

  // Integral of the deceleration error against a reference with the lag of the brakes. It stops
  // when the brakes do not cause the error: standstill, ABS, brakes at their limits.
  void Trim(const Demand& demand, T wanted, T deceleration, const Targets& targets, T supplied, T h,
            State* s) const {
    s->reference[0] += (supplied * wanted - s->reference[0]) * h / (response_time + h);
    s->reference[1] += (s->reference[0] - s->reference[1]) * h / (filter_time + h);
    T change = 0;
    if (demand.abs_active) {  // a deficit due to the road's friction is not compensated later
      for (T& reference : s->reference) reference = Min(reference, deceleration);
    } else if (demand.speed > trim_speed_min && !targets.limited) {
      change = h * trim_gain * (s->reference[1] - deceleration);
      if (targets.idle) change = Max(change, 0.0);
    }
    // The bounds close with the demand: the trim is zero when braking ends.
    const T limit = Min(trim_max + trim_share * wanted, wanted);
    s->trim = Clamp(s->trim + change, -limit, limit);
  }

  // Moves a supply valve to the demanded pressure of the brakes. A decreasing pressure is held back
  // by the brakes' hysteresis: the supply falls below the target until a model of the brakes has
  // reached it. For released brakes the supply is at the push-out pressure, from which they act
  // without delay.
  void Supply(int circuit, T wanted, T h, State* s) const {
    T* supply = &s->supply[circuit];
    T* chamber = &s->chamber[circuit];
    T* effective = &s->effective[circuit];
    T* lowering = &s->lowering[circuit];
    const T error = *effective - wanted;
    const bool off = wanted <= distribution.push_out && error < kNear * hysteresis;
    if (error > 0 && !off) {
      *lowering = Min(1.0, *lowering + error / hysteresis * h / hysteresis_time);
    } else if (error < -kNear * hysteresis || off) {
      *lowering = 0;  // the brakes follow an increasing pressure at once
    }
    const T target = Max(0.0, wanted - *lowering * hysteresis);
    *supply = Clamp(target, *supply - h * fall_rate, *supply + h * rise_rate);
    *chamber += (*supply - *chamber) * h / (response_time + h);
    *effective = Clamp(*effective, *chamber, *chamber + hysteresis);
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_BRAKE_CONTROL_H_
