#include "plugin/tire.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <memory>
#include <string>

#include "plugin/config.h"
#include "plugin/registration.h"
#include "plugin/spatial.h"

namespace iits {
namespace {

// Greatest stiffness of a wheel on its carcass spring, times step squared over inertia.
constexpr double kCarry = 0.9;
// Numbers of the sensors, and where slips begin in the state's signals.
constexpr int kForceSize = 3, kSlipSize = 2, kSlipFirst = 4;

const char* const kAttributes[] = {"count",
                                   "free_radius",
                                   "rolling_radius",
                                   "vertical_stiffness",
                                   "vertical_damping",
                                   "cornering_coefficient",
                                   "pneumatic_trail",
                                   "nominal_load",
                                   "friction_lateral",
                                   "friction_longitudinal",
                                   "friction_load_slope",
                                   "shape_lateral",
                                   "shape_longitudinal",
                                   "curvature_lateral",
                                   "curvature_longitudinal",
                                   "load_saturation",
                                   "slip_stiffness",
                                   "relaxation_lateral",
                                   "relaxation_load_exponent",
                                   "relaxation_longitudinal",
                                   "rolling_resistance"};

bool EndsWith(const std::string& text, const std::string& tail) {
  return text.size() >= tail.size() &&
         text.compare(text.size() - tail.size(), tail.size(), tail) == 0;
}

}  // namespace

Tire* Tire::Create(const mjModel* m, int instance) {
  std::unique_ptr<Tire> t(new Tire());
  const Attribute attributes[] = {
      {"count", 1, 2, &t->count_},
      {"free_radius", 0.05, 5, &t->free_radius_},
      {"rolling_radius", 0.05, 5, &t->rolling_radius_},
      {"vertical_stiffness", 1e3, 1e8, &t->vertical_stiffness_},
      {"vertical_damping", 0, 1e6, &t->vertical_damping_},
      {"cornering_coefficient", 0.1, 50, &t->cornering_coefficient_},
      {"pneumatic_trail", 0, 0.5, &t->pneumatic_trail_},
      {"nominal_load", 100, 1e6, &t->nominal_load_},
      {"friction_lateral", 0.01, 3, &t->friction_lateral_},
      {"friction_longitudinal", 0.01, 3, &t->friction_longitudinal_},
      {"friction_load_slope", 0, 0.5, &t->friction_load_slope_},
      {"shape_lateral", 1, 2, &t->shape_lateral_},
      {"shape_longitudinal", 1, 2, &t->shape_longitudinal_},
      {"curvature_lateral", -10, 1, &t->curvature_lateral_},
      {"curvature_longitudinal", -10, 1, &t->curvature_longitudinal_},
      {"load_saturation", 0.5, 20, &t->load_saturation_},
      {"slip_stiffness", 1, 100, &t->slip_stiffness_},
      {"relaxation_lateral", 0.05, 5, &t->relaxation_lateral_},
      {"relaxation_load_exponent", 0, 2, &t->relaxation_load_exponent_},
      {"relaxation_longitudinal", 0.05, 5, &t->relaxation_longitudinal_},
      {"rolling_resistance", 0, 0.2, &t->rolling_resistance_},
  };
  if (!ReadAttributes(m, instance, attributes)) return nullptr;
  t->Prepare();

  for (int body : BodiesOfInstance(m, instance)) {
    int joint = m->body_jntadr[body];
    if (m->body_jntnum[body] != 1 || m->jnt_type[joint] != mjJNT_HINGE) {
      mju_warning("plugin instance '%s': wheel body '%s' must have exactly one hinge joint",
                  InstanceName(m, instance).c_str(), m->names + m->name_bodyadr[body]);
      return nullptr;
    }
    const int dof = m->jnt_dofadr[joint];
    const double radius = t->rolling_radius_;
    const double carry = kCarry * m->dof_M0[dof] / (t->slip_stiffness_ * radius * radius);
    t->wheels_.push_back({body, m->body_parentid[body], m->body_rootid[body], dof, carry});
  }
  t->common_dof_ = t->wheels_.empty() ? -1 : t->wheels_[0].dof;
  for (const Wheel& wheel : t->wheels_) {
    t->common_dof_ = CommonDof(m, t->common_dof_, wheel.dof);
  }
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] != instance) continue;
    std::string name = m->names + m->name_sensoradr[i];
    Sensor sensor = {m->sensor_adr[i], -1};
    for (size_t w = 0; w < t->wheels_.size(); ++w) {
      if (m->sensor_objtype[i] == mjOBJ_BODY && m->sensor_objid[i] == t->wheels_[w].body) {
        sensor.wheel = static_cast<int>(w);
      }
    }
    if (sensor.wheel < 0) {
      mju_warning("plugin instance '%s': sensor '%s' needs objtype='body' and one of its wheels",
                  InstanceName(m, instance).c_str(), name.c_str());
      return nullptr;
    }
    (EndsWith(name, "_tire_slip") ? t->slip_sensors_ : t->force_sensors_).push_back(sensor);
  }
  if (!t->road_.Bind(m, instance)) return nullptr;
  return t.release();
}

int Tire::StateSize(const mjModel* m, int instance) {
  return kStateSize * static_cast<int>(BodiesOfInstance(m, instance).size());
}

void Tire::Reset(mjtNum* plugin_state) const {
  State* states = reinterpret_cast<State*>(plugin_state);
  for (size_t i = 0; i < wheels_.size(); ++i) {
    states[i] = State();
    states[i].station = states[i].next_station = Road::kUnknownStation;
  }
}

void Tire::Sensors(const mjModel* m, mjData* d, int instance) const {
  const State* states =
      reinterpret_cast<const State*>(d->plugin_state + m->plugin_stateadr[instance]);
  for (const Sensor& sensor : force_sensors_) {
    for (int i = 0; i < kForceSize; ++i) {
      d->sensordata[sensor.address + i] = states[sensor.wheel].signal[i];
    }
  }
  for (const Sensor& sensor : slip_sensors_) {
    for (int i = 0; i < kSlipSize; ++i) {
      d->sensordata[sensor.address + i] = states[sensor.wheel].signal[kSlipFirst + i];
    }
  }
}

void Tire::Advance(const mjModel* m, mjData* d, int instance) const {
  State* states = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  for (size_t i = 0; i < wheels_.size(); ++i) {
    State& s = states[i];
    s.bristle_x = s.next_bristle_x;
    s.bristle_y = s.next_bristle_y;
    s.bristle_spin = s.next_bristle_spin;
    s.station = s.next_station;
  }
}

void RegisterTire() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.tire";
  plugin.capabilityflags = mjPLUGIN_PASSIVE | mjPLUGIN_SENSOR;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  // Not mjSTAGE_VEL, at which MuJoCo computes velocities of all subtrees first, for nothing; what
  // mjSTAGE_ACC needs, accelerometers have computed already.
  plugin.needstage = mjSTAGE_ACC;
  plugin.nstate = Tire::StateSize;
  // Forces are (Fx, Fy, Fz), slips are (longitudinal slip, slip angle).
  plugin.nsensordata = +[](const mjModel* m, int, int sensor) {
    return EndsWith(m->names + m->name_sensoradr[sensor], "_tire_slip") ? kSlipSize : kForceSize;
  };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    Tire* tire = Tire::Create(m, instance);
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(tire);
    return tire ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<Tire*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum* plugin_state, void* plugin_data, int) {
    reinterpret_cast<Tire*>(plugin_data)->Reset(plugin_state);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability_bit) {
    const Tire* tire = reinterpret_cast<Tire*>(d->plugin_data[instance]);
    if (capability_bit & mjPLUGIN_PASSIVE) tire->Passive(m, d, instance);
    if (capability_bit & mjPLUGIN_SENSOR) tire->Sensors(m, d, instance);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<Tire*>(d->plugin_data[instance])->Advance(m, d, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace iits
