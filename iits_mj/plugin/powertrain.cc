#include "plugin/powertrain.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>

#include "plugin/config.h"
#include "plugin/registration.h"

namespace iits {
namespace {

const char* const kAttributes[] = {
    // engine
    "idle_speed", "governed_speed", "reference_torque", "engine_inertia", "torque_rise_rate",
    "torque_rise_rate_low", "torque_rise_threshold", "torque_fall_rate", "torque_fall_rate_low",
    "torque_fall_threshold", "boost_lag", "engine_brake_power", "engine_brake_speed",
    "idle_fuel_rate", "full_load_speed", "full_load_torque", "drag_speed", "drag_torque",
    "pedal_map_speed", "pedal_map_pedal", "pedal_map_torque", "fuel_map_torque", "fuel_map_speed",
    "fuel_map_consumption",
    // gearbox
    "ratios", "gear_inertias", "reverse_ratio", "final_drive", "efficiency", "wheel_radius",
    "shift_cut_time", "synchronization_time", "synchronization_time_max", "synchronized_difference",
    "clutch_close_time",
    // shift strategy
    "shift_strategy", "start_gear", "downshift_delay", "downshift_margin", "min_gear_time",
    "reversal_time", "upshift_gear", "upshift_pedal", "upshift_speed", "downshift_gear",
    "downshift_pedal", "downshift_speed", "acceleration_lag", "load_lag", "pedal_lag",
    "lowest_speed", "lowest_speed_pedal", "rolling_speed", "recovery_horizon",
    "upshift_speed_margin", "downshift_speed_margin", "downshift_speed_max", "power_speed",
    "overspeed", "overspeed_braking", "torque_reserve", "failed_reserve", "failed_load",
    "built_up_torque", "stuck_acceleration", "first_gear_delay", "engage_speed_max", "pedal_up",
    "floored_pedal", "kick_down_pedal", "kick_down_rise", "kick_down_speed", "skip_up_max",
    "skip_down_max", "braking_speed_low", "braking_speed_high", "braking_deceleration",
    "adaptive_period", "adaptive_reserve", "adaptive_gain", "adaptive_speed_max",
    // clutch and driveline
    "clutch_engagement_time", "clutch_torque_max", "driveline_efficiency", "driveline_stiffness",
    "driveline_damping"};

using Output = Powertrain::Output;

struct Signal {
  const char* name;
  double (*value)(const Powertrain& p, const Output& o);
};

}  // namespace

Powertrain* Powertrain::Create(const mjModel* m, int instance) {
  std::unique_ptr<Powertrain> p(new Powertrain());
  ClutchControl& clutch = p->clutch_control_;
  const struct {
    const char* name;
    double low, high;
    double* value;
  } attributes[] = {
      {"clutch_engagement_time", 0.01, 10, &clutch.engagement_time},
      {"clutch_torque_max", 1, 1e6, &p->clutch_torque_max_},
      {"driveline_efficiency", 0.5, 1, &p->driveline_efficiency_},
      {"driveline_stiffness", 1, 1e9, &p->driveline_stiffness_},
      {"driveline_damping", 1, 1e9, &p->driveline_damping_},
  };
  for (const auto& a : attributes) {
    *a.value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, a.value)) return nullptr;
  }
  if (!p->FindActuators(m, instance) || !p->FindSensors(m, instance)) return nullptr;
  if (!p->engine_.Read(m, instance)) return nullptr;
  if (!p->gearbox_.Read(m, instance)) return nullptr;
  clutch.idle_speed = p->engine_.idle_speed();
  clutch.launch_share = std::min(1.0, p->engine_.reference_torque() / p->clutch_torque_max_);
  return p.release();
}

bool Powertrain::FindActuators(const mjModel* m, int instance) {
  for (int i : ActuatorsOfInstance(m, instance)) {
    std::string name = LocalName(mj_id2name(m, mjOBJ_ACTUATOR, i));
    int* slot = name == "accelerator_pedal"   ? &pedal_
                : name == "engine_brake"      ? &engine_brake_
                : name == "transmission_mode" ? &mode_
                : name == "retarder"          ? &retarder_
                                              : nullptr;
    if (!slot || *slot >= 0) {
      mju_warning(
          "plugin instance '%s': actuator '%s' is not one of accelerator_pedal, "
          "engine_brake, retarder, transmission_mode, each at most once",
          InstanceName(m, instance).c_str(), name.c_str());
      return false;
    }
    *slot = i;
  }
  if (pedal_ < 0 || m->actuator_trntype[pedal_] != mjTRN_TENDON) {
    mju_warning(
        "plugin instance '%s': needs the actuator accelerator_pedal with a fixed tendon "
        "over the driven wheels as its transmission",
        InstanceName(m, instance).c_str());
    return false;
  }
  air_brake_ = PartnerInstance(m, pedal_, "iits.air_brake");
  return true;
}

bool Powertrain::FindSensors(const mjModel* m, int instance) {
  static const Signal kSignals[] = {
      {"gear", [](const Powertrain&, const Output& o) { return o.gear; }},
      {"shift_in_process", [](const Powertrain&, const Output& o) { return o.shift_in_process; }},
      {"engine_speed", [](const Powertrain&, const Output& o) { return o.engine_speed; }},
      {"engine_torque", [](const Powertrain&, const Output& o) { return o.engine_torque; }},
      {"engine_torque_percent",
       [](const Powertrain& p, const Output& o) {
         return 100 * o.indicated_torque / p.engine_.reference_torque();
       }},
      {"torque_loss_percent",
       [](const Powertrain& p, const Output& o) {
         return 100 * o.drag_torque / p.engine_.reference_torque();
       }},
      {"fuel_rate", [](const Powertrain&, const Output& o) { return o.fuel_rate; }},
      {"fuel_used", [](const Powertrain&, const Output& o) { return o.fuel_used; }},
      {"clutch_engagement", [](const Powertrain&, const Output& o) { return o.clutch_engagement; }},
      {"propeller_shaft_torque", [](const Powertrain&, const Output& o) { return o.shaft_torque; }},
      {"propeller_shaft_speed", [](const Powertrain&, const Output& o) { return o.shaft_speed; }},
      {"accelerator_pedal_position", [](const Powertrain&, const Output& o) { return o.pedal; }},
  };
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] != instance) continue;
    std::string name = LocalName(mj_id2name(m, mjOBJ_SENSOR, i));
    size_t before = sensors_.size();
    for (const Signal& signal : kSignals) {
      if (name == signal.name) sensors_.emplace_back(m->sensor_adr[i], signal.value);
    }
    if (sensors_.size() == before) {
      std::string known;
      for (const Signal& signal : kSignals)
        known += std::string(known.empty() ? "" : ", ") + signal.name;
      mju_warning("plugin instance '%s': sensor '%s' is unknown; known are %s",
                  InstanceName(m, instance).c_str(), name.c_str(), known.c_str());
      return false;
    }
  }
  return true;
}

// Mass of the kinematic tree that the first driven wheel belongs to. Read in every step: a model's
// masses may be changed, and rollouts share one plugin object between models.
double Powertrain::VehicleMass(const mjModel* m) const {
  int wrap = m->tendon_adr[m->actuator_trnid[2 * pedal_]];
  if (m->wrap_type[wrap] != mjWRAP_JOINT) return 0;
  int body = m->jnt_bodyid[m->wrap_objid[wrap]];
  return m->body_subtreemass[m->body_rootid[body]];
}

Powertrain::Controls Powertrain::ReadControls(const mjModel* m, const mjData* d) const {
  auto control = [m, d](int actuator, double high) {
    if (actuator < 0) return 0.0;
    double value = d->ctrl[m->actuator_ctrladr[actuator]];
    return std::isfinite(value) ? std::clamp(value, 0.0, high) : 0.0;
  };
  int mode = static_cast<int>(std::lround(control(mode_, 2)));
  return {control(pedal_, 1), control(engine_brake_, 1), static_cast<GearboxInput::Mode>(mode),
          VehicleMass(m)};
}

// A vehicle that is found rolling is in the gear for its speed, clutch closed, no torque.
void Powertrain::Initialize(double shaft_speed, Core* core) const {
  *core = Core();
  core->initialized = 1;
  int gear = gearbox_.GearForSpeed(engine_, shaft_speed);
  double input_speed = gearbox_.Ratio(gear) * shaft_speed;
  bool rolling = input_speed > 1.05 * engine_.idle_speed();
  core->engine.speed =
      rolling ? std::min(input_speed, engine_.brake_speed()) : engine_.idle_speed();
  core->engine.torque = engine_.Drag(core->engine.speed);
  core->gearbox.gear = core->gearbox.target = gear;
  core->gearbox.gear_time = 1e3;
  core->gearbox.shaft_speed = shaft_speed;
  core->engagement = rolling ? 1 : 0;
}

void Powertrain::Step(const Controls& controls, double shaft_speed, double h, Core* core,
                      Output* output) const {
  EngineState* engine = &core->engine;
  GearboxState* gearbox = &core->gearbox;
  const double speed_before = engine->speed;

  const GearboxInput input = {
      controls.mode,      controls.pedal, controls.engine_brake,   shaft_speed,
      core->shaft_torque, engine->speed,  core->engagement < 0.01, controls.mass};
  gearbox_.Update(engine_, input, h, gearbox);
  EngineRequest request = gearbox_.Request(engine_, input, *gearbox);
  if (core->engagement < 0.5) request.engine_brake = 0;
  engine_.Update(request, h, engine);

  const int gear = static_cast<int>(gearbox->gear);
  const double ratio = gearbox_.Ratio(gear);
  const double input_speed = ratio * shaft_speed;
  const double torque = engine_.BrakeTorque(*engine);
  const double inertia = engine_.inertia() + gearbox_.InputInertia(gear);
  output->engine_torque = torque;
  output->fuel_rate = engine_.FuelRate(*engine);

  double clutch_torque = 0;
  if (gear == 0) {
    core->torsion = core->engagement = 0;
    engine->speed = std::max(0.0, engine->speed + h * torque / inertia);
  } else {
    if (gearbox->phase == Gearbox::kCut) {
      // With the torque, so that a clutch that still slips does not drag the engine down.
      core->engagement -= core->engagement * std::min(1.0, h / std::max(request.time_left, h));
    } else if (gearbox->phase == Gearbox::kClose) {
      core->engagement = std::min(1.0, gearbox->phase_time / gearbox_.close_time());
    } else if (gearbox->phase == Gearbox::kInGear) {
      core->engagement =
          clutch_control_.Update(core->engagement, engine->speed, input_speed, controls.pedal, h);
    }
    double capacity =
        core->engagement * clutch_torque_max_ * clutch_control_.StallGuard(engine->speed);
    // Stiffness and damping are given at the wheels.
    double reduction = ratio * gearbox_.final_drive();
    const ElasticClutch clutch = {driveline_stiffness_ / (reduction * reduction),
                                  driveline_damping_ / (reduction * reduction)};
    clutch_torque =
        clutch.Step(torque, inertia, input_speed, capacity, h, &core->torsion, &engine->speed);
  }
  // Losses oppose the flow of power, whichever way it goes.
  double efficiency = gearbox_.Efficiency() * driveline_efficiency_;
  core->shaft_torque = clutch_torque * ratio * (clutch_torque > 0 ? efficiency : 1 / efficiency);

  output->gear = gearbox->target;
  output->shift_in_process = gearbox->phase != Gearbox::kInGear;
  output->engine_speed = speed_before;
  output->indicated_torque = engine->torque;
  output->drag_torque = engine_.Drag(speed_before);
  output->fuel_used = core->fuel_used;
  output->clutch_engagement = core->engagement;
  output->shaft_torque = core->shaft_torque;
  output->shaft_speed = shaft_speed;
  output->pedal = controls.pedal;
  core->fuel_used += h * output->fuel_rate;
}

void Powertrain::Actuator(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  int out = m->actuator_outadr[pedal_];
  double shaft_speed = d->actuator_velocity[out];
  if (!std::isfinite(shaft_speed)) shaft_speed = 0;
  s->next = s->now;
  if (s->next.initialized == 0) Initialize(shaft_speed, &s->next);
  Step(ReadControls(m, d), shaft_speed, m->opt.timestep, &s->next, &s->output);
  s->next_is_fresh = 1;
  d->actuator_force[out] = s->next.shaft_torque;
  if (engine_brake_ >= 0) d->actuator_force[m->actuator_outadr[engine_brake_]] = 0;
  if (mode_ >= 0) d->actuator_force[m->actuator_outadr[mode_]] = 0;
  if (retarder_ >= 0) d->actuator_force[m->actuator_outadr[retarder_]] = 0;
}

void Powertrain::Sensors(const mjModel* m, mjData* d, int instance) const {
  const State* s = reinterpret_cast<const State*>(d->plugin_state + m->plugin_stateadr[instance]);
  for (const auto& [address, value] : sensors_) d->sensordata[address] = value(*this, s->output);
}

// Commits what the last `compute` found; nothing when actuation is disabled.
void Powertrain::Advance(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  if (s->next_is_fresh == 0) return;
  s->now = s->next;
  s->endurance.shaft_torque = -s->now.shaft_torque;
  s->endurance.engine_speed = s->now.engine.speed;
  s->next_is_fresh = 0;
}

void RegisterPowertrain() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.powertrain";
  plugin.capabilityflags = mjPLUGIN_ACTUATOR | mjPLUGIN_SENSOR;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.needstage = mjSTAGE_ACC;
  plugin.nstate = +[](const mjModel*, int) { return Powertrain::kStateSize; };
  plugin.nsensordata = +[](const mjModel*, int, int) { return 1; };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    Powertrain* powertrain = Powertrain::Create(m, instance);
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(powertrain);
    return powertrain ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<Powertrain*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum* plugin_state, void*, int) {
    mju_zero(plugin_state, Powertrain::kStateSize);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability_bit) {
    const Powertrain* powertrain = reinterpret_cast<Powertrain*>(d->plugin_data[instance]);
    if (capability_bit & mjPLUGIN_ACTUATOR) powertrain->Actuator(m, d, instance);
    if (capability_bit & mjPLUGIN_SENSOR) powertrain->Sensors(m, d, instance);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<Powertrain*>(d->plugin_data[instance])->Advance(m, d, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace iits
