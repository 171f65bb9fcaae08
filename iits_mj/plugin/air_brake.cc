#include "plugin/air_brake.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "plugin/config.h"
#include "plugin/registration.h"
#include "plugin/spatial.h"

namespace iits {
namespace {

const char* const kAttributes[] = {"dead_time",
                                   "build_up_time_constant",
                                   "release_time_constant",
                                   "torque_per_pressure",
                                   "parking_torque",
                                   "wheel_radius",
                                   "circuit",
                                   "push_out_pressure",
                                   "hysteresis_pressure",
                                   "abs_release_slip",
                                   "abs_reapply_slip",
                                   "abs_speed_min",
                                   "stiffness",
                                   "supply_rise_rate",
                                   "supply_fall_rate",
                                   "pressure_max",
                                   "hill_hold_time",
                                   "demand",
                                   "pressure_front",
                                   "pressure_drive",
                                   "pressure_trailer"};

constexpr double kDemandMin = 0.01;    // smaller demands are none [m/s2]
constexpr double kDemandMax = 15.687;  // range of SPN 2920 [m/s2]
constexpr double kParkingTime = 0.3;   // of the spring brakes' chambers [s], judgement
// Upgrade on which the vehicle would roll back, as deceleration [m/s2].
constexpr double kUphill = 0.05;

}  // namespace

AirBrake* AirBrake::Create(const mjModel* m, int instance) {
  std::unique_ptr<AirBrake> b(new AirBrake());
  if (!b->FindActuators(m, instance) || !b->ReadAxles(m, instance) ||
      !b->control_.Read(m, instance) || !b->FindSensors(m, instance)) {
    return nullptr;
  }
  return b.release();
}

bool AirBrake::ReadAxles(const mjModel* m, int instance) {
  struct PerAxle {
    const char* name;
    double low, high;
    double WheelBrake::* member;
  };
  static const PerAxle kPerAxle[] = {
      {"dead_time", 0, 2, &WheelBrake::dead_time},
      {"build_up_time_constant", 0.001, 10, &WheelBrake::build_up_time_constant},
      {"release_time_constant", 0.001, 10, &WheelBrake::release_time_constant},
      {"torque_per_pressure", 0, 10, &WheelBrake::torque_per_pressure},
      {"parking_torque", 0, 1e6, &WheelBrake::parking_torque},
      {"wheel_radius", 0.05, 5, &WheelBrake::wheel_radius},
  };
  static const PerAxle kCommon[] = {
      {"push_out_pressure", 0, 1e6, &WheelBrake::push_out_pressure},
      {"hysteresis_pressure", 0, 1e6, &WheelBrake::hysteresis_pressure},
      {"abs_release_slip", 0.01, 1, &WheelBrake::abs_release_slip},
      {"abs_reapply_slip", 0, 1, &WheelBrake::abs_reapply_slip},
      {"abs_speed_min", 0.1, 100, &WheelBrake::abs_speed_min},
      {"stiffness", 1, 1e9, &WheelBrake::stiffness},
  };
  std::vector<int> hubs = BodiesOfInstance(m, instance);
  const size_t axles = hubs.size() / 2;
  if (axles < 1 || axles > kAxlesMax || hubs.size() % 2) {
    mju_warning(
        "plugin instance '%s': %zu hub bodies reference it; allowed are 2 to %d, two an axle",
        InstanceName(m, instance).c_str(), hubs.size(), kWheelsMax);
    return false;
  }
  wheels_.resize(hubs.size());
  std::vector<double> circuit;
  if (!ReadNumbers(m, instance, "circuit", axles, axles, 0, kCircuits - 1, &circuit)) return false;
  for (const PerAxle& a : kPerAxle) {
    std::vector<double> values;
    if (!ReadNumbers(m, instance, a.name, axles, axles, a.low, a.high, &values)) return false;
    for (size_t i = 0; i < wheels_.size(); ++i) wheels_[i].*a.member = values[i / 2];
  }
  for (const PerAxle& a : kCommon) {
    double value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, &value)) return false;
    for (WheelBrake& wheel : wheels_) wheel.*a.member = value;
  }
  double dead_time = 0, response = 0, radius = 0;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    WheelBrake& wheel = wheels_[i];
    wheel.circuit = static_cast<int>(circuit[i / 2]);
    wheel.hub = hubs[i];
    wheel.dof = -1;
    int children = 0;
    for (int body = 1; body < m->nbody; ++body) {
      if (m->body_parentid[body] != wheel.hub) continue;
      ++children;
      int joint = m->body_jntadr[body];
      if (m->body_jntnum[body] == 1 && m->jnt_type[joint] == mjJNT_HINGE) {
        wheel.dof = m->jnt_dofadr[joint];
      }
    }
    if (wheel.dof < 0 || children != 1) {
      const char* name = mj_id2name(m, mjOBJ_BODY, wheel.hub);
      mju_warning("plugin instance '%s': hub body '%s' must have one child, a wheel on one hinge",
                  InstanceName(m, instance).c_str(), name ? name : "");
      return false;
    }
    wheel.inertia = m->dof_M0[wheel.dof];
    dead_time = std::max(dead_time, wheel.dead_time);
    response = std::max(response, wheel.dead_time + wheel.build_up_time_constant);
    radius += wheel.wheel_radius / wheels_.size();
  }
  for (WheelBrake& wheel : wheels_) {
    Line line = {wheel.circuit, wheel.dead_time};
    auto same = [&line](const Line& l) {
      return l.circuit == line.circuit && l.dead_time == line.dead_time;
    };
    auto place = std::find_if(lines_.begin(), lines_.end(), same);
    line_of_wheel_.push_back(static_cast<int>(place - lines_.begin()));
    if (place == lines_.end()) lines_.push_back(line);
    rates_.push_back(wheel.Rates(m->opt.timestep));
  }
  sample_spacing_ = dead_time / (DeadTimeLine::kSlots - 2);
  double mass = m->body_subtreemass[m->body_rootid[wheels_[0].hub]];
  control_.set_response_time(response);
  control_.set_uphill_torque_min(mass * kUphill * radius);
  return true;
}

bool AirBrake::FindActuators(const mjModel* m, int instance) {
  for (int i : ActuatorsOfInstance(m, instance)) {
    std::string name = LocalName(mj_id2name(m, mjOBJ_ACTUATOR, i));
    int* slot = name == "xbr_demand"      ? &demand_
                : name == "xbr_mode"      ? &mode_
                : name == "parking_brake" ? &parking_
                : name == "brake_pedal"   ? &pedal_
                : name == "xbr_ebi_mode"  ? &ebi_mode_
                                          : nullptr;
    if (!slot || *slot >= 0) {
      mju_warning(
          "plugin instance '%s': actuator '%s' is not one of xbr_demand, xbr_mode, "
          "parking_brake, brake_pedal, xbr_ebi_mode, each at most once",
          InstanceName(m, instance).c_str(), name.c_str());
      return false;
    }
    *slot = i;
  }
  if (demand_ < 0 || mode_ < 0) {
    mju_warning("plugin instance '%s': needs the actuators xbr_demand and xbr_mode",
                InstanceName(m, instance).c_str());
    return false;
  }
  powertrain_ = PartnerInstance(m, demand_, "iits.powertrain");
  return true;
}

// Speed of the hub along its own x axis.
double AirBrake::HubSpeed(const mjModel* m, const mjData* d, int hub) const {
  mjtNum linear[3], angular[3];
  PointVelocity(m, d, hub, d->xpos + 3 * hub, linear, angular);
  const mjtNum* frame = d->xmat + 9 * hub;
  return frame[0] * linear[0] + frame[3] * linear[1] + frame[6] * linear[2];
}

BrakeDemand AirBrake::ReadDemand(const mjModel* m, const mjData* d, const State& s) const {
  auto control = [m, d](int actuator, double low, double high) {
    double value = d->ctrl[m->actuator_ctrladr[actuator]];
    return std::isfinite(value) ? std::clamp(value, low, high) : 0.0;
  };
  BrakeDemand demand;
  demand.deceleration = -control(demand_, -kDemandMax, 0);
  // Addition and maximum meet a driver's brake pedal that there is none of: both act alike.
  demand.active = std::lround(control(mode_, 0, 3)) > 0 && demand.deceleration > kDemandMin;
  demand.speed = 0.5 * (HubSpeed(m, d, wheels_[0].hub) + HubSpeed(m, d, wheels_[1].hub));
  demand.abs_active = false;
  demand.uphill_torque = 0;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    demand.abs_active = demand.abs_active || s.now.wheel[i].abs_phase != WheelBrake::kNormal;
    demand.uphill_torque -= s.wind_up.torque[i];
  }
  return demand;
}

// Brake torque from the committed pressures.
void AirBrake::Passive(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  const double h = m->opt.timestep;
  s->next_wind_up = s->wind_up;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    const WheelBrake& wheel = wheels_[i];
    double capacity = wheel.Torque(s->now.wheel[i], s->now.parking);
    double torque =
        WheelBrake::Grip(Rates(i, h), capacity, d->qvel[wheel.dof], &s->next_wind_up.angle[i]);
    s->next_wind_up.torque[i] = torque;
    d->qfrc_passive[wheel.dof] -= torque;
  }
  s->next_wind_up_is_fresh = 1;
}

// Pressures of the next step from the controls of this one.
void AirBrake::Actuator(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  const double h = m->opt.timestep;
  BrakeDemand demand = ReadDemand(m, d, *s);
  Pneumatics* next = &s->next;
  *next = s->now;
  control_.Update(demand, h, &next->control);
  next->line.Push(next->control.supply, h, sample_spacing_);
  double supplies[kWheelsMax];
  for (size_t i = 0; i < lines_.size(); ++i) {
    const Line& line = lines_[i];
    supplies[i] = next->line.Look(line.circuit, line.dead_time, next->control.supply[line.circuit]);
  }
  for (size_t i = 0; i < wheels_.size(); ++i) {
    const WheelBrake& wheel = wheels_[i];
    double supply = supplies[line_of_wheel_[i]];
    bool braked = next->wheel[i].pressure > wheel.push_out_pressure;
    double speed = braked ? HubSpeed(m, d, wheel.hub) : 0;
    wheel.Update(Rates(i, h), supply, speed, d->qvel[wheel.dof], &next->wheel[i]);
  }
  double parking = 0;
  if (parking_ >= 0) {
    double wanted = d->ctrl[m->actuator_ctrladr[parking_]];
    parking = std::isfinite(wanted) ? std::clamp(wanted, 0.0, 1.0) : 0;
    d->actuator_force[m->actuator_outadr[parking_]] = 0;
  }
  next->parking += LagShare(h, kParkingTime) * (parking - next->parking);
  s->next_is_fresh = 1;
  s->xbr_active = demand.active;
  s->abs_active = demand.abs_active;
  d->actuator_force[m->actuator_outadr[demand_]] = 0;
  d->actuator_force[m->actuator_outadr[mode_]] = 0;
  if (pedal_ >= 0) d->actuator_force[m->actuator_outadr[pedal_]] = 0;
  if (ebi_mode_ >= 0) d->actuator_force[m->actuator_outadr[ebi_mode_]] = 0;
}

// Commits what the last `compute` found; nothing for a part of the engine that is disabled.
void AirBrake::Advance(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  if (s->next_is_fresh != 0) s->now = s->next;
  if (s->next_wind_up_is_fresh != 0) s->wind_up = s->next_wind_up;
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
  plugin.nsensordata = +[](const mjModel*, int, int) { return 1; };
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
