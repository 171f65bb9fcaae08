#include "plugin/air_brake.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "plugin/registration.h"
#include "plugin/spatial.h"

namespace iits {
namespace {

const char* const kAttributes[] = {
    // axles
    "circuit", "dead_time", "build_up_time_constant", "release_time_constant",
    "torque_per_pressure", "parking_torque", "wheel_radius", "chamber_volume",
    // wheel ends and lines
    "push_out_pressure", "hysteresis_pressure", "abs_release_slip", "abs_reapply_slip",
    "abs_speed_min", "abs_time_constant", "abs_yaw_rise_rate", "abs_slip_lag", "abs_slip_lead",
    "abs_speed_low", "stiffness", "trailer_line_delay", "parking_time_constant",
    // control
    "supply_rise_rate", "supply_fall_rate", "pressure_max", "release_rate", "pedal_deceleration",
    "rolling_resistance", "filter_time_constant", "trim_gain", "trim_max", "trim_share",
    "trim_speed_min", "hysteresis_time_constant", "endurance_speed_off", "endurance_speed_on",
    "endurance_rate", "hold_speed", "hold_deceleration", "hold_release_speed", "hill_hold_time",
    "hill_hold_min",
    // distribution
    "mass_light", "mass_heavy", "demand", "share_light", "share_heavy",
    // air supply
    "reservoir_volume", "compressor_displacement", "governor_cut_in", "governor_cut_out",
    "spring_begin_pressure", "spring_full_pressure"};

// Of SPN 2920 [m/s2]: resolution and range.
constexpr double kDemandMin = 1. / 2048, kDemandMax = 15.687;

}  // namespace

// Speed of the hub along its own x axis.
double AirBrake::HubSpeed(const mjModel* m, const mjData* d, int hub) const {
  mjtNum linear[3], angular[3];
  PointVelocity(m, d, hub, d->xpos + 3 * hub, linear, angular);
  const mjtNum* frame = d->xmat + 9 * hub;
  return frame[0] * linear[0] + frame[3] * linear[1] + frame[6] * linear[2];
}

// Control value within its range; 0 where there is none, or not a number.
double AirBrake::Control(const mjModel* m, const mjData* d, int actuator, double low,
                         double high) const {
  if (actuator < 0) return 0;
  double value = d->ctrl[m->actuator_ctrladr[actuator]];
  return std::isfinite(value) ? std::clamp(value, low, high) : 0;
}

BrakeDemand AirBrake::ReadDemand(const mjModel* m, const mjData* d, const State& s) const {
  BrakeDemand demand;
  demand.xbr = -Control(m, d, demand_, -kDemandMax, 0);
  if (demand.xbr < kDemandMin) demand.xbr = 0;
  // The fourth value of both two-bit fields is not defined: as if off, friction only.
  long mode = std::lround(Control(m, d, mode_, 0, 3));
  long ebi_mode = std::lround(Control(m, d, ebi_mode_, 0, 3));
  demand.xbr_mode = static_cast<BrakeDemand::XbrMode>(mode < 3 ? mode : 0);
  demand.ebi_mode = static_cast<BrakeDemand::EbiMode>(ebi_mode < 3 ? ebi_mode : 0);
  demand.pedal = Control(m, d, pedal_, 0, 1);
  demand.speed = 0.5 * (HubSpeed(m, d, wheels_[0].hub) + HubSpeed(m, d, wheels_[1].hub));
  // Of the model as it is now, which may have been varied since it was made.
  demand.mass = m->body_subtreemass[m->body_rootid[wheels_[0].hub]];
  demand.gravity = mju_norm3(m->opt.gravity);
  demand.abs_active = demand.abs_on_drive = false;
  demand.uphill_torque = 0;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    const bool abs = s.now.wheel[i].abs_active != 0;
    demand.abs_active = demand.abs_active || abs;
    demand.abs_on_drive = demand.abs_on_drive || (abs && wheels_[i].circuit == kDrive);
    demand.uphill_torque -= s.wind_up.torque[i];
  }
  EnduranceState shaft = ReadPartner<EnduranceState>(m, d, powertrain_);
  demand.shaft_force = shaft_ratio_ * shaft.shaft_torque;
  demand.shaft_force_max = shaft_ratio_ * shaft.shaft_torque_max;
  demand.reservoir = s.next.reservoir.pressure;
  return demand;
}

// Brake torque from the committed pressures.
void AirBrake::Passive(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  const double h = m->opt.timestep;
  double power = 0;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    const WheelBrake& wheel = wheels_[i];
    double capacity = wheel.Torque(s->now.wheel[i], s->now.parking[wheel.circuit]);
    if (capacity == 0) {
      s->next_wind_up.angle[i] = s->next_wind_up.torque[i] = 0;
      continue;
    }
    double speed = d->qvel[wheel.dof];
    double angle = s->wind_up.angle[i];
    double torque = WheelBrake::Grip(Rates(i, h), capacity, speed, &angle);
    s->next_wind_up.angle[i] = angle;
    s->next_wind_up.torque[i] = torque;
    d->qfrc_passive[wheel.dof] -= torque;
    power += torque * speed;
  }
  s->next_work = 0.5 * h * power;
  s->next_wind_up_is_fresh = 1;
}

// No pressure in valves, lines and chambers: most of the time.
bool AirBrake::Quiet(const State& s, double h) const {
  double pressure = 0;
  for (double supply : s.next.control.supply) pressure += supply;
  for (size_t i = 0; i < wheels_.size(); ++i) pressure += s.now.wheel[i].effective;
  return pressure == 0 && s.line.clock + h - s.line.last_used > dead_time_max_;
}

void AirBrake::Copy(const Pneumatics& from, Pneumatics* to) const {
  const size_t size = offsetof(Pneumatics, wheel) + wheels_.size() * sizeof(WheelBrakeState);
  std::memcpy(to, &from, size);
}

// From the supply valves to the chambers.
void AirBrake::Brake(const mjModel* m, const mjData* d, State* s) const {
  const double h = m->opt.timestep;
  const Pneumatics& now = s->now;
  Pneumatics* next = &s->next;
  if (Quiet(*s, h)) return;
  double supplies[kWheelsMax];
  for (size_t i = 0; i < lines_.size(); ++i) {
    const Line& line = lines_[i];
    const double current = next->control.supply[line.circuit];
    supplies[i] = s->line.Look(line.circuit, line.dead_time, h, current);
  }
  double duty[kWheelsMax];
  for (size_t i = 0; i < wheels_.size(); ++i) {
    const WheelBrake& wheel = wheels_[i];
    const bool braked = now.wheel[i].pressure > wheel.push_out_pressure;
    const double speed = braked ? HubSpeed(m, d, wheel.hub) : 0;
    duty[i] =
        wheel.Duty(Rates(i, h), now.wheel[i], speed, d->qvel[wheel.dof], &next->wheel[i].slip);
  }
  for (size_t i = 0; i < wheels_.size(); i += 2) {  // axle by axle
    // Driven axles by the wheel with less grip (select low), the others each wheel for itself.
    if (wheels_[i].circuit == kDrive) duty[i] = duty[i + 1] = std::min(duty[i], duty[i + 1]);
    for (size_t j : {i, i + 1}) {
      const double supply = supplies[line_of_wheel_[j]];
      next->wheel[j].abs_active = wheels_[j].Active(supply, duty[j], now.wheel[j]);
    }
  }
  for (size_t i = 0; i < wheels_.size(); ++i) {
    const WheelBrake& wheel = wheels_[i];
    const double supply = supplies[line_of_wheel_[i]];
    WheelBrakeState* chamber = &next->wheel[i];
    if (supply == 0 && chamber->pressure == 0) continue;
    const WheelBrakeRates rates = Rates(i, h);
    const size_t other = i ^ 1;  // wheel of the axle
    const bool other_active = next->wheel[other].abs_active != 0;
    const double rise_max = wheel.RiseMax(rates, now.wheel[i], now.wheel[other], other_active);
    const double before = wheel.Air(*chamber);
    wheel.Update(rates, supply, rise_max, duty[i], chamber);
    const double drawn = wheel.Air(*chamber) - before;
    if (drawn > 0) reservoirs_.Draw(wheel.circuit, drawn, &next->reservoir);
  }
}

// Spring brakes by the driver's wish, or because the air that holds them off is gone.
void AirBrake::Park(double wanted, double h, Pneumatics* next) const {
  for (int i = 0; i < kCircuits; ++i) {
    double target = std::max(wanted, reservoirs_.Springs(i, next->reservoir));
    if (next->parking[i] == target) continue;
    double change = LagShare(h, parking_time_constant_) * (target - next->parking[i]);
    next->parking[i] += change;
    if (std::abs(target - next->parking[i]) < 1e-6) next->parking[i] = target;
    if (change < 0) {  // air fills the chambers, which holds the springs off
      double air = spring_volume_[i] * (next->reservoir.pressure[i] + kAtmosphere);
      reservoirs_.Draw(i, -change * air, &next->reservoir);
    }
  }
}

// Pressures of the next step from the controls of this one.
void AirBrake::Actuator(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  const double h = m->opt.timestep;
  Pneumatics* next = &s->next;
  Copy(s->now, next);
  if (next->control.initialized == 0) reservoirs_.Fill(&next->reservoir);
  const BrakeDemand demand = ReadDemand(m, d, *s);
  const BrakeEffort effort = control_.Update(demand, h, &next->control);
  Brake(m, d, s);
  Park(Control(m, d, parking_, 0, 1), h, next);
  const double engine_speed = ReadPartner<EnduranceState>(m, d, powertrain_).engine_speed;
  reservoirs_.Pump(engine_speed, h, &next->reservoir);
  s->next_endurance.shaft_torque = shaft_ratio_ > 0 ? effort.shaft_force / shaft_ratio_ : 0;
  if (demand.abs_on_drive) s->next_endurance.shaft_torque = EnduranceDemand::kLetGo;
  s->next_endurance.cut_traction = effort.active;
  s->next_is_fresh = 1;
  s->xbr_active = demand.xbr > 0 && demand.xbr_mode != BrakeDemand::kOff;
  s->abs_active = demand.abs_active;
  for (int actuator : {demand_, mode_, parking_, pedal_, ebi_mode_}) {
    if (actuator >= 0) d->actuator_force[m->actuator_outadr[actuator]] = 0;
  }
}

// Commits what the last `compute` found; nothing for a part of the engine that is disabled.
void AirBrake::Advance(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  if (s->next_is_fresh != 0) {
    Copy(s->next, &s->now);
    s->line.Push(s->now.control.supply, m->opt.timestep, sample_spacing_);
    s->endurance = s->next_endurance;
  }
  if (s->next_wind_up_is_fresh != 0) {
    // Torque times the mean of the wheel's speed before and after the step: what it took from the
    // kinetic energy. The velocities are the new ones by now.
    double power = 0;
    for (size_t i = 0; i < wheels_.size(); ++i) {
      s->wind_up.angle[i] = s->next_wind_up.angle[i];
      s->wind_up.torque[i] = s->next_wind_up.torque[i];
      power += s->wind_up.torque[i] * d->qvel[wheels_[i].dof];
    }
    s->work += s->next_work + 0.5 * m->opt.timestep * power;
  }
  s->next_is_fresh = s->next_wind_up_is_fresh = 0;
}

void RegisterAirBrake() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.air_brake";
  plugin.capabilityflags = mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE | mjPLUGIN_SENSOR;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.needstage = mjSTAGE_ACC;
  plugin.nstate = +[](const mjModel*, int) { return AirBrake::kStateSize; };
  plugin.nsensordata = AirBrake::SensorSize;
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    AirBrake* air_brake = AirBrake::Create(m, instance);
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(air_brake);
    return air_brake ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<AirBrake*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum* plugin_state, void*, int) {
    mju_zero(plugin_state, AirBrake::kStateSize);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability_bit) {
    const AirBrake* air_brake = reinterpret_cast<AirBrake*>(d->plugin_data[instance]);
    if (capability_bit & mjPLUGIN_PASSIVE) air_brake->Passive(m, d, instance);
    if (capability_bit & mjPLUGIN_ACTUATOR) air_brake->Actuator(m, d, instance);
    if (capability_bit & mjPLUGIN_SENSOR) air_brake->Sensors(m, d, instance);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<AirBrake*>(d->plugin_data[instance])->Advance(m, d, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace iits
