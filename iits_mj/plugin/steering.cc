#include "plugin/steering.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "plugin/config.h"
#include "plugin/registration.h"

namespace iits {
namespace {

const char* const kAttributes[] = {"ratio",     "dead_band",     "angle_max", "rate_max",
                                   "stiffness", "time_constant", "wheelbase", "track"};

}  // namespace

Steering* Steering::Create(const mjModel* m, int instance) {
  std::unique_ptr<Steering> s(new Steering());
  const Attribute attributes[] = {
      {"ratio", 1, 100, &s->ratio_},           {"dead_band", 0, 1, &s->dead_band_},
      {"angle_max", 0.1, 100, &s->angle_max_}, {"rate_max", 0.01, 1000, &s->rate_max_},
      {"stiffness", 1, 1e8, &s->stiffness_},   {"time_constant", 0, 10, &s->time_constant_},
      {"wheelbase", 0.5, 20, &s->wheelbase_},  {"track", 0.1, 5, &s->track_},
  };
  if (!ReadAttributes(m, instance, attributes)) return nullptr;
  std::vector<int> actuators = ActuatorsOfInstance(m, instance);
  if (actuators.size() != 1 || m->actuator_trntype[actuators[0]] != mjTRN_TENDON) {
    mju_warning("plugin instance '%s': needs one actuator with a tendon over both knuckle joints",
                InstanceName(m, instance).c_str());
    return nullptr;
  }
  s->actuator_ = actuators[0];
  int tendon = m->actuator_trnid[2 * s->actuator_];
  int wrap = m->tendon_adr[tendon];
  if (m->tendon_num[tendon] != 2 || m->wrap_type[wrap] != mjWRAP_JOINT ||
      m->wrap_type[wrap + 1] != mjWRAP_JOINT) {
    mju_warning("plugin instance '%s': its tendon must be fixed, over the left and right knuckle",
                InstanceName(m, instance).c_str());
    return nullptr;
  }
  s->joint_left_ = m->wrap_objid[wrap];
  s->joint_right_ = m->wrap_objid[wrap + 1];
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] == instance) s->sensors_.push_back(m->sensor_adr[i]);
  }
  return s.release();
}

// Elastic linkage: holds each knuckle at its Ackermann angle.
void Steering::Passive(const mjModel* m, mjData* d, int instance) const {
  const State* s = reinterpret_cast<const State*>(d->plugin_state + m->plugin_stateadr[instance]);
  double tangent = std::tan(s->pitman_angle / ratio_);
  double half = 0.5 * track_ / wheelbase_ * tangent;
  const int joints[2] = {joint_left_, joint_right_};
  const double targets[2] = {std::atan(tangent / (1 - half)), std::atan(tangent / (1 + half))};
  for (int i = 0; i < 2; ++i) {
    double angle = d->qpos[m->jnt_qposadr[joints[i]]];
    d->qfrc_passive[m->jnt_dofadr[joints[i]]] += stiffness_ * (targets[i] - angle);
  }
}

// Steering actuator: first-order lag within the rate limit, then the play of the gear.
void Steering::Actuator(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  const double h = m->opt.timestep;
  double demand = d->ctrl[m->actuator_ctrladr[actuator_]];
  demand = std::isfinite(demand) ? std::clamp(demand, -angle_max_, angle_max_) : s->wheel_angle;
  double follow = time_constant_ > 0 ? 1 - std::exp(-h / time_constant_) : 1;
  double change = std::clamp(follow * (demand - s->wheel_angle), -h * rate_max_, h * rate_max_);
  s->next_wheel_angle = s->wheel_angle + change;
  s->next_pitman_angle = std::clamp(s->pitman_angle, s->next_wheel_angle - 0.5 * dead_band_,
                                    s->next_wheel_angle + 0.5 * dead_band_);
  d->actuator_force[m->actuator_outadr[actuator_]] = 0;
}

void Steering::Sensors(const mjModel* m, mjData* d, int instance) const {
  const State* s = reinterpret_cast<const State*>(d->plugin_state + m->plugin_stateadr[instance]);
  for (int address : sensors_) d->sensordata[address] = s->wheel_angle;
}

void Steering::Advance(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  s->wheel_angle = s->next_wheel_angle;
  s->pitman_angle = s->next_pitman_angle;
}

void RegisterSteering() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.steering";
  plugin.capabilityflags = mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE | mjPLUGIN_SENSOR;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.needstage = mjSTAGE_ACC;  // at mjSTAGE_VEL MuJoCo would compute all subtrees' velocities
  plugin.nstate = +[](const mjModel*, int) { return Steering::kStateSize; };
  plugin.nsensordata = +[](const mjModel*, int, int) { return 1; };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    Steering* steering = Steering::Create(m, instance);
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(steering);
    return steering ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<Steering*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum* plugin_state, void*, int) {
    mju_zero(plugin_state, Steering::kStateSize);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability_bit) {
    const Steering* steering = reinterpret_cast<Steering*>(d->plugin_data[instance]);
    if (capability_bit & mjPLUGIN_PASSIVE) steering->Passive(m, d, instance);
    if (capability_bit & mjPLUGIN_ACTUATOR) steering->Actuator(m, d, instance);
    if (capability_bit & mjPLUGIN_SENSOR) steering->Sensors(m, d, instance);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<Steering*>(d->plugin_data[instance])->Advance(m, d, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace iits
