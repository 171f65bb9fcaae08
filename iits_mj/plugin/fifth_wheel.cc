#include "plugin/fifth_wheel.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "plugin/config.h"
#include "plugin/registration.h"

namespace iits {
namespace {

constexpr double kWindUp = 0.002;  // [rad] of yaw to full friction

const char* const kAttributes[] = {"roll_stiffness", "roll_damping", "roll_lash", "yaw_friction"};

}  // namespace

FifthWheel* FifthWheel::Create(const mjModel* m, int instance) {
  std::unique_ptr<FifthWheel> f(new FifthWheel());
  const struct {
    const char* name;
    double low, high;
    double* value;
  } attributes[] = {
      {"roll_stiffness", 0, 1e9, &f->roll_stiffness_},
      {"roll_damping", 0, 1e7, &f->roll_damping_},
      {"roll_lash", 0, 0.5, &f->roll_lash_},
      {"yaw_friction", 0, 1e6, &f->yaw_friction_},
  };
  for (const auto& a : attributes) {
    *a.value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, a.value)) return nullptr;
  }
  std::vector<int> bodies = BodiesOfInstance(m, instance);
  if (bodies.size() == 1 && m->body_jntnum[bodies[0]] == 3) {
    int joint = m->body_jntadr[bodies[0]];
    f->yaw_ = joint;
    f->roll_ = joint + 2;
    return f.release();
  }
  mju_warning("plugin instance '%s': one body with hinges yaw, pitch, roll must reference it",
              InstanceName(m, instance).c_str());
  return nullptr;
}

void FifthWheel::Passive(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  int roll_dof = m->jnt_dofadr[roll_];
  double roll = d->qpos[m->jnt_qposadr[roll_]];
  double beyond = roll - std::clamp(roll, -roll_lash_, roll_lash_);
  double torque = 0;
  if (beyond != 0) {
    torque = -roll_stiffness_ * beyond - roll_damping_ * d->qvel[roll_dof];
    // The plate pushes, it never pulls back into the lash.
    torque = beyond > 0 ? std::min(torque, 0.0) : std::max(torque, 0.0);
  }
  d->qfrc_passive[roll_dof] += torque;

  int yaw_dof = m->jnt_dofadr[yaw_];
  s->next_wind_up = std::clamp(s->wind_up + m->opt.timestep * d->qvel[yaw_dof], -kWindUp, kWindUp);
  d->qfrc_passive[yaw_dof] -= yaw_friction_ * s->next_wind_up / kWindUp;
}

void FifthWheel::Advance(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  s->wind_up = s->next_wind_up;
}

void RegisterFifthWheel() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.fifth_wheel";
  plugin.capabilityflags = mjPLUGIN_PASSIVE;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.nstate = +[](const mjModel*, int) { return FifthWheel::kStateSize; };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    FifthWheel* fifth_wheel = FifthWheel::Create(m, instance);
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(fifth_wheel);
    return fifth_wheel ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<FifthWheel*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum* plugin_state, void*, int) {
    mju_zero(plugin_state, FifthWheel::kStateSize);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int) {
    reinterpret_cast<FifthWheel*>(d->plugin_data[instance])->Passive(m, d, instance);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<FifthWheel*>(d->plugin_data[instance])->Advance(m, d, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace iits
