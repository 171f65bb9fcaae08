#include "plugin/brake_control.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "plugin/config.h"

namespace iits {
namespace {

constexpr double kPedalMin = 0.01;  // a pedal below is up
constexpr double kNear = 0.1;       // as share of the hysteresis: no matter of direction

}  // namespace

bool BrakeControl::Read(const mjModel* m, int instance) {
  const Attribute attributes[] = {
      {"supply_rise_rate", 1, 1e9, &rise_rate_},
      {"supply_fall_rate", 1, 1e9, &fall_rate_},
      {"pressure_max", 1, 1e8, &pressure_max_},
      {"release_rate", 0.01, 1e6, &release_rate_},
      {"pedal_deceleration", 0, 100, &pedal_deceleration_},
      {"rolling_resistance", 0, 1, &rolling_resistance_},
      {"filter_time_constant", 0.001, 10, &filter_time_},
      {"trim_gain", 0, 10, &trim_gain_},
      {"trim_max", 0, 10, &trim_max_},
      {"trim_share", 0, 1, &trim_share_},
      {"trim_speed_min", 0, 100, &trim_speed_min_},
      {"endurance_speed_off", 0, 100, &shaft_speed_off_},
      {"endurance_speed_on", 0, 100, &shaft_speed_on_},
      {"endurance_rate", 0.01, 1e6, &endurance_rate_},
      {"push_out_pressure", 1, 1e6, &push_out_},
      {"hysteresis_pressure", 1, 1e6, &hysteresis_},
      {"hysteresis_time_constant", 0.001, 10, &hysteresis_time_},
      {"hold_speed", 0, 10, &hold_speed_},
      {"hold_deceleration", 0, 10, &hold_deceleration_},
      {"hold_release_speed", 0, 10, &hold_release_speed_},
      {"hill_hold_time", 0, 60, &hold_time_max_},
      {"hill_hold_min", 0, 10, &hold_uphill_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  if (shaft_speed_on_ <= shaft_speed_off_) {
    mju_warning(
        "plugin instance '%s': attribute 'endurance_speed_on' = %g must exceed "
        "endurance_speed_off = %g",
        InstanceName(m, instance).c_str(), shaft_speed_on_, shaft_speed_off_);
    return false;
  }
  return distribution_.Read(m, instance);
}

void BrakeControl::AddWheel(int circuit, double radius, double inertia,
                            double torque_per_pressure) {
  distribution_.AddWheel(circuit, torque_per_pressure / radius);
  spin_mass_ += inertia / (radius * radius);
  radius_sum_ += radius;
  ++wheels_;
}

// Driver and XBR together, as J1939-71 says at SPN 2916. The XBR part ends gradually in motion.
BrakeControl::Level BrakeControl::Arbitrate(const BrakeDemand& demand, double h,
                                            BrakeControlState* s) const {
  double asked = demand.xbr_mode == BrakeDemand::kOff ? 0 : demand.xbr;
  const bool moving = std::abs(demand.speed) > hold_speed_;
  s->xbr = moving ? std::max(asked, s->xbr - release_rate_ * h) : asked;
  double driver = demand.pedal > kPedalMin ? demand.pedal * pedal_deceleration_ : 0;
  bool addition = demand.xbr_mode == BrakeDemand::kAddition;
  return {driver, addition ? driver + s->xbr : std::max(driver, s->xbr)};
}

// A vehicle braked to a standstill is held while the demand lasts; on an upgrade also afterwards,
// until the driveline carries it, or drives it backwards, or the hill-hold time is over.
void BrakeControl::Hold(const BrakeDemand& demand, bool active, double h,
                        BrakeControlState* s) const {
  if (active) {
    if (std::abs(demand.speed) < hold_speed_) s->holding = 1;
    s->hold_time = 0;
  } else if (s->holding != 0) {
    s->hold_time += h;
    double hill = demand.mass * hold_uphill_;  // what rolls the vehicle back [N]
    bool carried = demand.uphill_torque < hill * radius_sum_ / std::max(wheels_, 1);
    bool reversing = demand.shaft_force > hill;
    if (carried || reversing || s->hold_time > hold_time_max_) s->holding = 0;
  }
  if (std::abs(demand.speed) > hold_release_speed_) s->holding = 0;
}

// Braking force of this deceleration on the level, less rolling resistance; wheels spin down, too.
double BrakeControl::Force(const BrakeDemand& demand, double deceleration) const {
  double rolling = rolling_resistance_ * demand.mass * demand.gravity;
  return std::max(0.0, (demand.mass + spin_mass_) * deceleration - rolling);
}

// Braking force of the shaft to count on when friction has had time to respond: what it gives and
// what it could give, both carried on as they have changed. So friction is there when a gear change
// begins, ahead of a retarder that fades out, and gone when one has filled.
double BrakeControl::ShaftForce(const BrakeDemand& demand, double h, BrakeControlState* s) const {
  auto ahead = [this, h](double now, double* past) {
    double change = now - *past;
    *past += change * h / (response_time_ + h);
    return now + change;
  };
  double force = ahead(demand.shaft_force, &s->shaft);
  return std::min(force, std::max(0.0, ahead(demand.shaft_force_max, &s->shaft_max)));
}

// Who gives the force. The shaft brakes in any case (engine drag); friction gives the rest.
BrakeControl::Targets BrakeControl::Blend(const BrakeDemand& demand, const Level& level,
                                          double shaft_force, const BrakeControlState& s) const {
  Targets t = {};
  t.effort.active = level.total > 0;
  double wanted = t.effort.active ? std::max(0.0, level.total + s.trim) : 0;
  double friction = 0, force = 0;
  bool endurance_only = demand.ebi_mode == BrakeDemand::kEnduranceOnly && s.xbr > 0;
  if (t.effort.active) {
    force = Force(demand, wanted);
    friction = std::max(0.0, force - shaft_force);
    if (endurance_only) friction = std::min(friction, Force(demand, level.driver));
    t.idle = friction <= 0;
    // Endurance brakes act on one axle group and know no slip: off while ABS works. Near walking
    // speed the driveline opens soon: where friction may serve, it takes over before.
    if (demand.ebi_mode != BrakeDemand::kFrictionOnly && !demand.abs_active) {
      double range = (demand.speed - shaft_speed_off_) / (shaft_speed_on_ - shaft_speed_off_);
      bool integrated = demand.ebi_mode == BrakeDemand::kIntegration;
      t.effort.shaft_force = integrated ? force * std::clamp(range, 0.0, 1.0) : force;
      t.limited = endurance_only && level.driver == 0 && force > demand.shaft_force_max;
    }
  }
  double held = s.holding != 0 ? Force(demand, hold_deceleration_) : 0;
  bool prepared = t.effort.active && !(endurance_only && level.driver == 0);
  if (!prepared && held == 0) return t;
  distribution_.Pressures(std::max(friction, held), shaft_force, wanted, demand.mass, t.pressure);
  for (int i = 0; i < kCircuits; ++i) {
    double available = std::min(pressure_max_, demand.reservoir[i]);
    t.limited = t.limited || t.pressure[i] > available;
    t.pressure[i] = std::min(t.pressure[i], available);
  }
  return t;
}

// Integral of the deceleration's error against a reference that is as slow as the brakes. It stops
// when the error says nothing about the brakes: standing, ABS at work, brakes at their limits.
void BrakeControl::Trim(const BrakeDemand& demand, double wanted, double deceleration,
                        const Targets& targets, double supplied, double h,
                        BrakeControlState* s) const {
  s->reference[0] += (supplied * wanted - s->reference[0]) * h / (response_time_ + h);
  s->reference[1] += (s->reference[0] - s->reference[1]) * h / (filter_time_ + h);
  double limit = trim_max_ + trim_share_ * wanted;
  double change = 0;
  if (demand.abs_active) {  // what friction does not allow is not owed afterwards
    for (double& reference : s->reference) reference = std::min(reference, deceleration);
  } else if (demand.speed > trim_speed_min_ && !targets.limited) {
    change = h * trim_gain_ * (s->reference[1] - deceleration);
    if (targets.idle) change = std::max(change, 0.0);
  }
  // With the demand the bounds close: nothing is left of the trim when braking ends.
  s->trim = std::clamp(s->trim + change, -std::min(limit, wanted), std::min(limit, wanted));
}

// Moves a supply valve to the pressure that shall act in the brakes. On the way down these hold
// back by their hysteresis: the supply goes lower, until a model of them shows what is wanted. Once
// they are let off it waits at the push-out pressure, from where they act without delay.
void BrakeControl::Supply(int circuit, double wanted, double h, BrakeControlState* s) const {
  double* supply = &s->supply[circuit];
  double* chamber = &s->chamber[circuit];
  double* effective = &s->effective[circuit];
  double* lowering = &s->lowering[circuit];
  const double error = *effective - wanted;
  const bool off = wanted <= push_out_ && error < kNear * hysteresis_;
  if (error > 0 && !off) {
    *lowering = std::min(1.0, *lowering + error / hysteresis_ * h / hysteresis_time_);
  } else if (error < -kNear * hysteresis_ || off) {
    *lowering = 0;  // on the way up the brakes follow at once
  }
  double target = std::max(0.0, wanted - *lowering * hysteresis_);
  *supply = std::clamp(target, *supply - h * fall_rate_, *supply + h * rise_rate_);
  *chamber += (*supply - *chamber) * h / (response_time_ + h);
  *effective = std::clamp(*effective, *chamber, *chamber + hysteresis_);
}

BrakeEffort BrakeControl::Update(const BrakeDemand& demand, double h, BrakeControlState* s) const {
  if (s->initialized == 0) {
    s->initialized = 1;
    s->speed = demand.speed;
    s->shaft = demand.shaft_force;
    s->shaft_max = demand.shaft_force_max;
  }
  double difference = demand.speed - s->speed;
  s->speed += difference * h / (filter_time_ + h);
  double deceleration = -difference / (filter_time_ + h);

  const Level level = Arbitrate(demand, h, s);
  Hold(demand, level.total > 0, h, s);
  const Targets targets = Blend(demand, level, ShaftForce(demand, h, s), *s);
  double supplied = 1;  // least share of a circuit's set point that its supply has reached
  for (int i = 0; i < kCircuits; ++i) {
    const double target = targets.pressure[i];
    Supply(i, target, h, s);
    if (target > 0)
      supplied =
          std::min(supplied, std::min(1.0, (s->supply[i] + s->lowering[i] * hysteresis_) / target));
  }
  Trim(demand, level.total, deceleration, targets, supplied, h, s);
  BrakeEffort effort = targets.effort;
  if (demand.ebi_mode == BrakeDemand::kIntegration) {
    // Asked for more no faster than friction can make room; anew after a gear change.
    double limit = std::min(s->asked, demand.shaft_force_max) + endurance_rate_ * demand.mass * h;
    effort.shaft_force = std::min(effort.shaft_force, std::max(0.0, limit));
  }
  s->asked = effort.shaft_force;
  return effort;
}

}  // namespace iits
