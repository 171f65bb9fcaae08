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
    "idle_speed", "governed_speed", "governor_droop", "reference_torque", "engine_inertia",
    "pedal_up", "pedal_fade", "torque_rise_rate", "torque_rise_rate_low", "torque_rise_threshold",
    "torque_fall_rate", "torque_fall_rate_low", "torque_fall_threshold", "torque_cut_time",
    "boost_lag", "spool_time", "idle_gain", "idle_integral_gain", "idle_band", "idle_integral_min",
    "idle_integral_max", "idle_forget_time", "synchronization_lag", "synchronization_torque_share",
    "synchronization_brake_share", "engine_brake_power", "engine_brake_speed",
    "engine_brake_exponent", "engine_brake_speed_min", "engine_brake_fade", "engine_brake_lag",
    "engine_brake_release_lag", "idle_fuel_rate", "full_load_speed", "full_load_torque",
    "drag_speed", "drag_torque", "pedal_map_speed", "pedal_map_pedal", "pedal_map_torque",
    "fuel_map_torque", "fuel_map_speed", "fuel_map_consumption",
    // retarder and what the brakes take from the engine
    "retarder_torque_max", "retarder_full_torque_speed", "retarder_power_max",
    "retarder_power_continuous", "retarder_heat_time", "retarder_derate_heat", "retarder_fill_time",
    "retarder_empty_time", "pedal_return_time",
    // gearbox
    "ratios", "gear_inertias", "reverse_ratio", "final_drive", "efficiency", "wheel_radius",
    "shift_cut_time", "synchronization_time", "synchronization_time_max", "synchronized_difference",
    "clutch_close_time",
    // shift strategy
    "shift_strategy", "start_gear", "downshift_delay", "downshift_margin", "min_gear_time",
    "reversal_time", "upshift_gear", "upshift_pedal", "upshift_speed", "downshift_gear",
    "downshift_pedal", "downshift_speed", "acceleration_lag", "load_lag", "pedal_lag",
    "lowest_speed", "lowest_speed_pedal", "rolling_speed", "recovery_horizon", "recovery_speed",
    "recovery_time", "upshift_speed_margin", "downshift_speed_margin", "downshift_speed_max",
    "power_speed", "overspeed", "overspeed_braking", "torque_reserve", "failed_reserve",
    "failed_load", "built_up_torque", "stuck_acceleration", "first_gear_delay", "engage_speed_max",
    "floored_pedal", "kick_down_pedal", "kick_down_rise", "kick_down_speed", "skip_up_max",
    "skip_down_max", "braking_speed_low", "braking_speed_high", "braking_deceleration",
    "adaptive_period", "adaptive_reserve", "adaptive_gain", "adaptive_speed_max",
    "adaptive_horizon",
    // clutch and driveline
    "clutch_engagement_time", "clutch_opening_time", "clutch_torque_max", "clutch_launch_range",
    "clutch_alike_range", "clutch_release_share", "clutch_release_share_coast",
    "clutch_stall_share", "clutch_stall_range", "driveline_efficiency", "driveline_stiffness",
    "driveline_damping", "loss_reversal_speed"};

}  // namespace

Powertrain* Powertrain::Create(const mjModel* m, int instance) {
  std::unique_ptr<Powertrain> p(new Powertrain());
  if (!p->FindActuators(m, instance) || !p->FindSensors(m, instance)) return nullptr;
  p->FindWheels(m);
  const Attribute pedal[] = {{"pedal_return_time", 0.001, 60, &p->endurance_.return_time}};
  const Engine& engine = p->engine_;
  if (!p->engine_.Read(m, instance) || !p->gearbox_.Read(m, instance) ||
      !p->retarder_.Read(m, instance) || !ReadAttributes(m, instance, pedal) ||
      !p->driveline_.Read(m, instance, p->gearbox_.final_drive(), engine.idle_speed(),
                          engine.pedal_up(), engine.reference_torque())) {
    return nullptr;
  }
  p->endurance_.pedal_up = engine.pedal_up();
  return p.release();
}

bool Powertrain::FindActuators(const mjModel* m, int instance) {
  for (int i : ActuatorsOfInstance(m, instance)) {
    std::string name = LocalName(mj_id2name(m, mjOBJ_ACTUATOR, i));
    int* slot = name == "accelerator_pedal"   ? &pedal_
                : name == "engine_brake"      ? &engine_brake_
                : name == "transmission_mode" ? &mode_
                : name == "retarder"          ? &retarder_lever_
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

// The driven wheels, through the tendon of the accelerator's transmission.
void Powertrain::FindWheels(const mjModel* m) {
  const int tendon = m->actuator_trnid[2 * pedal_];
  const double gear = m->actuator_gear[6 * pedal_];
  for (int i = m->tendon_adr[tendon]; i < m->tendon_adr[tendon] + m->tendon_num[tendon]; ++i) {
    if (m->wrap_type[i] != mjWRAP_JOINT) continue;
    wheels_.emplace_back(m->jnt_dofadr[m->wrap_objid[i]], gear * m->wrap_prm[i]);
  }
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
  int mode = static_cast<int>(control(mode_, 2) + 0.5);  // rounded; lround is a call
  return {{control(pedal_, 1), control(engine_brake_, 1), control(retarder_lever_, 1)},
          static_cast<GearboxInput::Mode>(mode),
          ReadPartner<EnduranceDemand>(m, d, air_brake_),
          VehicleMass(m)};
}

// From the wheels as they are now; `actuator_velocity` is of before the step when `advance` runs.
double Powertrain::ShaftSpeed(const mjData* d) const {
  double speed = 0;
  for (const auto& [dof, share] : wheels_) speed += share * d->qvel[dof];
  return std::isfinite(speed) ? speed : 0;
}

// While a change synchronizes, the gearbox's input turns with the engine, as in the gear to come.
GearData Powertrain::Gear(const GearboxState& gearbox) const {
  const int gear = static_cast<int>(gearbox.gear);
  const int turning = gear ? gear : static_cast<int>(gearbox.target);
  return {gearbox_.Ratio(gear), engine_.inertia() + gearbox_.InputInertia(turning),
          gearbox_.Efficiency()};
}

// An engine that is being taken out counts for nothing, so that the retarder fills in time.
EnduranceGearing Powertrain::Gearing(const Core& core) const {
  const bool closed = core.gearbox.phase == Gearbox::kInGear && core.driveline.engagement >= 1;
  const double ratio = std::abs(gearbox_.Ratio(static_cast<int>(core.gearbox.gear)));
  const double behind = 1 / driveline_.efficiency();
  return {closed ? ratio * behind / gearbox_.Efficiency() : 0, behind};
}

// A vehicle that is found rolling is in the gear for its speed, clutch closed, no torque.
void Powertrain::Initialize(double shaft_speed, Core* core) const {
  *core = Core();
  core->initialized = 1;
  const double idle = engine_.idle_speed();
  int gear = gearbox_.GearForSpeed(engine_, shaft_speed);
  double input_speed = gearbox_.Ratio(gear) * shaft_speed;
  bool rolling = input_speed > driveline_.control().release_share_coast * idle;
  core->engine.speed = rolling ? std::min(input_speed, engine_.brake_speed()) : idle;
  core->engine.torque = engine_.Drag(core->engine.speed);
  core->gearbox.gear = core->gearbox.target = gear;
  core->gearbox.gear_time = 0;
  core->gearbox.shaft_speed = shaft_speed;
  driveline_.SetGear(Gear(core->gearbox), &core->driveline);
  core->driveline.engagement = rolling ? 1 : 0;
}

// Of the clutch, as the phase of a gear change or the launch wants it.
double Powertrain::Engagement(const Core& core, const EngineRequest& request, double pedal,
                              double input_speed, double h) const {
  const double engagement = core.driveline.engagement;
  const GearboxState& gearbox = core.gearbox;
  if (gearbox.phase == Gearbox::kCut) {
    // With the torque, so that a clutch that still slips does not drag the engine down.
    return engagement - engagement * std::min(1.0, h / std::max(request.time_left, h));
  }
  if (gearbox.phase == Gearbox::kClose) {
    return std::min(1.0, gearbox.phase_time / gearbox_.close_time());
  }
  if (gearbox.phase != Gearbox::kInGear) return engagement;
  return driveline_.control().Update(engagement, core.engine.speed, input_speed, pedal, h);
}

void Powertrain::Step(const Controls& controls, double shaft_speed, double h, State* s) const {
  Core* core = &s->next;
  EngineState* engine = &core->engine;
  GearboxState* gearbox = &core->gearbox;
  const EnginePoint at = engine_.At(engine->speed);
  ReportStart(*core, &s->output);
  const double retarder_max = retarder_.Available(shaft_speed, core->retarder.heat);
  const EnduranceGearing before = Gearing(*core);
  const EnduranceCommand command =
      endurance_.Update(controls.levers, controls.demand, before, at.drag, at.brake_max,
                        retarder_max, h, &core->held_back);

  const GearboxInput input = {controls.mode,
                              command.pedal,
                              command.engine_brake,
                              shaft_speed,
                              core->shaft_torque,
                              engine->speed,
                              core->driveline.engagement <= 0,
                              controls.mass,
                              controls.levers.pedal,
                              controls.levers.engine_brake};
  gearbox_.Update(engine_, input, h, gearbox);
  EngineRequest request = gearbox_.Request(engine_, input, *gearbox);
  request.limited = core->held_back > 0;
  // Nearly always the driver's pedal is the one that counts: one look into the map serves both.
  const double pedal = controls.levers.pedal;
  const double driver_torque = engine_.PedalTorque(at, pedal);
  request.torque = request.pedal == pedal ? driver_torque : engine_.PedalTorque(at, request.pedal);
  if (core->driveline.engagement < 1) request.engine_brake = 0;
  engine_.Update(request, at, h, engine);

  const GearData gear = Gear(*gearbox);
  if (gear.ratio != 0) {
    core->driveline.engagement =
        Engagement(*core, request, command.pedal, gear.ratio * shaft_speed, h);
  }
  core->retarder_torque =
      retarder_.Update(command.retarder_torque, retarder_max, shaft_speed, h, &core->retarder);
  driveline_.Step(gear, engine_.BrakeTorque(at, *engine), core->retarder_torque, shaft_speed, h,
                  &core->driveline, &engine->speed, &s->work);
  core->shaft_torque = s->work.shaft_torque;

  ReportStep(at, request, command, retarder_max, pedal, driver_torque, s);
  ReportGears(s);
  core->fuel_used += h * s->output.fuel_rate;
  const EnduranceGearing after = Gearing(*core);
  s->next_endurance = {
      gearbox->gear < 0 ? core->shaft_torque : -core->shaft_torque,
      after.engine_factor * (at.drag + at.brake_max) + after.retarder_factor * retarder_max,
      engine->speed};
}

void Powertrain::Actuator(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  int out = m->actuator_outadr[pedal_];
  const double shaft_speed = ShaftSpeed(d);
  s->next = s->now;
  if (s->next.initialized == 0) Initialize(shaft_speed, &s->next);
  Step(ReadControls(m, d), shaft_speed, m->opt.timestep, s);
  s->next_is_fresh = 1;
  d->actuator_force[out] = s->next.shaft_torque;
  if (engine_brake_ >= 0) d->actuator_force[m->actuator_outadr[engine_brake_]] = 0;
  if (mode_ >= 0) d->actuator_force[m->actuator_outadr[mode_]] = 0;
  if (retarder_lever_ >= 0) d->actuator_force[m->actuator_outadr[retarder_lever_]] = 0;
}

// Commits what the last `compute` found; nothing when actuation is disabled.
void Powertrain::Advance(const mjModel* m, mjData* d, int instance) const {
  State* s = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  if (s->next_is_fresh == 0) return;
  s->now = s->next;
  s->work.Book(ShaftSpeed(d), m->opt.timestep, &s->now.energy);
  s->endurance = s->next_endurance;
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
  plugin.nsensordata = Powertrain::SensorSize;
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
