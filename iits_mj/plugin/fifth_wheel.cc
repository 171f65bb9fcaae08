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

const char* const kAttributes[] = {"roll_stiffness", "roll_damping", "roll_lash",
                                   "plate_width",    "kingpin_load", "yaw_friction"};

}  // namespace

FifthWheel* FifthWheel::Create(const mjModel* m, int instance) {
  std::unique_ptr<FifthWheel> f(new FifthWheel());
  const Attribute attributes[] = {
      {"roll_stiffness", 0, 1e9, &f->roll_stiffness_}, {"roll_damping", 0, 1e7, &f->roll_damping_},
      {"roll_lash", 0, 0.5, &f->roll_lash_},           {"plate_width", 0, 3, &f->plate_width_},
      {"kingpin_load", 0, 1e6, &f->kingpin_load_},     {"yaw_friction", 0, 1e6, &f->yaw_friction_},
  };
  if (!ReadAttributes(m, instance, attributes)) return nullptr;
  f->lift_moment_ = 0.5 * f->plate_width_ * f->kingpin_load_;
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

// The kingpin load presses the trailer onto the plate: it carries roll stiffly until the load has
// moved to the plate's edge. Then the plate opens at that moment, over the lash, and the locked
// kingpin carries the rest.
double FifthWheel::RollMoment(double roll, double rate) const {
  double elastic = roll_stiffness_ * std::abs(roll);
  double open = elastic - lift_moment_;  // as if there were no lash
  double beyond = open - roll_stiffness_ * roll_lash_;
  double moment = open > 0 ? lift_moment_ + std::max(0.0, beyond) : elastic;
  bool touching = open <= 0 || beyond > 0;
  // Damping never turns the push of plate or kingpin into a pull.
  double damping = touching ? roll_damping_ * (roll < 0 ? -rate : rate) : 0;
  double total = open <= 0 ? moment + damping : std::max(0.0, moment + damping);
  return roll < 0 ? total : -total;
}

void FifthWheel::Passive(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  int roll_dof = m->jnt_dofadr[roll_];
  d->qfrc_passive[roll_dof] += RollMoment(d->qpos[m->jnt_qposadr[roll_]], d->qvel[roll_dof]);

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
