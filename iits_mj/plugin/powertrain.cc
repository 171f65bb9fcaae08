// Powertrain plugin `iits.powertrain`. Actuators, by local name: `accelerator_pedal` (force:
// propeller-shaft torque; transmission: a fixed tendon over the driven wheels with coefficients
// final_drive / n), and optionally `engine_brake`, `retarder` and `transmission_mode` (force: 0).
#include "plugin/laws/powertrain.h"

#include <algorithm>
#include <cstddef>
#include <string>
#include <utility>

#include "plugin/plugin.h"

namespace iits {
namespace {

using Output = PowertrainOutput<double>;

#define IITS_SIGNAL(name) {#name, offsetof(Output, name) / sizeof(mjtNum)}
const struct {
  const char* name;
  size_t place;
} kSignals[] = {
    IITS_SIGNAL(gear),
    IITS_SIGNAL(gear_engaged),
    IITS_SIGNAL(shift_in_process),
    IITS_SIGNAL(engine_speed),
    IITS_SIGNAL(engine_torque),
    IITS_SIGNAL(engine_torque_percent),
    IITS_SIGNAL(torque_loss_percent),
    IITS_SIGNAL(engine_torque_percent_driver),
    IITS_SIGNAL(engine_load_percent),
    IITS_SIGNAL(engine_torque_mode),
    IITS_SIGNAL(fuel_rate),
    IITS_SIGNAL(fuel_used),
    IITS_SIGNAL(clutch_engagement),
    IITS_SIGNAL(input_shaft_speed),
    IITS_SIGNAL(propeller_shaft_torque),
    IITS_SIGNAL(propeller_shaft_speed),
    IITS_SIGNAL(accelerator_pedal_position),
    IITS_SIGNAL(engine_brake_torque),
    IITS_SIGNAL(engine_brake_torque_percent),
    IITS_SIGNAL(engine_brake_torque_percent_intended),
    IITS_SIGNAL(engine_brake_torque_percent_available),
    IITS_SIGNAL(retarder_torque),
    IITS_SIGNAL(retarder_torque_percent),
    IITS_SIGNAL(retarder_torque_percent_intended),
    IITS_SIGNAL(retarder_torque_percent_available),
    IITS_SIGNAL(retarder_heat),
    IITS_SIGNAL(engine_work),
    IITS_SIGNAL(driveline_loss),
    IITS_SIGNAL(clutch_loss),
    IITS_SIGNAL(retarder_work),
    IITS_SIGNAL(driveline_energy),
    IITS_SIGNAL(auxiliary_work),
};
#undef IITS_SIGNAL

// One sensor for several signals from gear_engaged on, because each sensor costs time in MuJoCo.
const char* const kReport = "powertrain_report";
const char* const kAnchor = "accelerator_pedal";
constexpr double kLastMode = 20;  // request for gear 18
constexpr int kReportSize = 5;
constexpr int kReportPlace = offsetof(Output, gear_engaged) / sizeof(mjtNum);
static_assert(offsetof(Output, engine_load_percent) - offsetof(Output, gear_engaged) ==
                  (kReportSize - 1) * sizeof(mjtNum),
              "the signals of powertrain_report are adjacent");

class PowertrainPlugin : public PluginBase {
 public:
  using State = PowertrainState<double>;

  static int SensorSize(const mjModel* m, int instance, int sensor) {
    const LocalNames names(m, instance, kAnchor);
    return names.Of(m, mjOBJ_SENSOR, sensor) == kReport ? kReportSize : 1;
  }

  Attributes Table();
  bool Bind(const mjModel* m, int instance);
  void Actuator(const mjModel* m, mjData* d, State* s) const;

  void Sensors(const mjModel*, mjData* d, const State* s) const {
    const mjtNum* output = reinterpret_cast<const mjtNum*>(&s->output);
    for (const auto& [address, place] : sensors_) d->sensordata[address] = output[place];
  }

  // Commits the last computed step; nothing when actuation is disabled.
  void Advance(const mjModel* m, mjData* d, State* s) const {
    s->Commit(ShaftSpeed(d), m->opt.timestep);
  }

 private:
  bool FindActuators(const mjModel* m, int instance);
  bool FindSensors(const mjModel* m, int instance);
  bool ReadLossMaps(const mjModel* m, int instance, const char* name);
  bool Check(const mjModel* m, int instance) const;
  void Prepare();

  // From qvel, since `actuator_velocity` is that before the step when `advance` runs.
  double ShaftSpeed(const mjData* d) const {
    double speed = 0;
    for (const auto& [dof, share] : wheels_) speed += share * d->qvel[dof];
    return std::isfinite(speed) ? speed : 0;
  }

  Powertrain<double> law_;
  Map<double> gear_loss_;              // axes of the gears' maps of losses
  std::vector<double> gear_loss_map_;  // of each gear
  std::string shift_strategy_;
  double wheel_radius_;
  int pedal_ = -1, engine_brake_ = -1, mode_ = -1, retarder_lever_ = -1;  // actuators
  int air_brake_ = -1;                                                    // instance
  int body_ = -1;                                                         // of a driven wheel
  std::vector<std::pair<int, double>> wheels_;  // degree of freedom, its share of the shaft's speed
  std::vector<std::pair<int, int>> sensors_;    // place in sensordata, place in Output
};

Attributes PowertrainPlugin::Table() {
  Engine<double>& e = law_.engine;
  Retarder<double>& r = law_.retarder;
  Gearbox<double>& b = law_.gearbox;
  Gears<double>& g = b.gears;
  ShiftParameters<double>& s = b.strategy;
  Driveline<double>& d = law_.driveline;
  ClutchControl<double>& c = d.control;
  return {
      // Engine.
      Number("idle_speed", 20, 200, &e.idle_speed),
      Number("governed_speed", 50, 1000, &e.governed_speed),
      Number("governor_droop", 0.001, 0.5, &e.governor_droop),
      Number("reference_torque", 1, 1e5, &e.reference_torque),
      Number("engine_inertia", 0.01, 1000, &e.inertia),
      Number("pedal_up", 0, 0.5, &e.pedal_up),
      Number("pedal_fade", 0.001, 1, &e.pedal_fade),
      Number("torque_rise_rate", 1, 1e6, &e.rise_rate),
      Number("torque_rise_rate_low", 1, 1e6, &e.rise_rate_low),
      Number("torque_rise_threshold", 0, 1e5, &e.rise_threshold),
      Number("torque_fall_rate", 1, 1e6, &e.fall_rate),
      Number("torque_fall_rate_low", 1, 1e6, &e.fall_rate_low),
      Number("torque_fall_threshold", 0, 1e5, &e.fall_threshold),
      Number("torque_cut_time", 0.001, 10, &e.cut_time),
      Number("boost_lag", 0.001, 10, &e.boost_lag),
      Number("spool_time", 0.01, 100, &e.spool_time),
      Number("idle_gain", 0, 1e4, &e.idle_gain),
      Number("idle_integral_gain", 0, 1e4, &e.idle_integral_gain),
      Number("idle_band", 0, 1000, &e.idle_band),
      Number("idle_integral_min", -1e5, 0, &e.idle_integral_min),
      Number("idle_integral_max", 0, 1e5, &e.idle_integral_max),
      Number("idle_forget_time", 0.001, 100, &e.idle_forget_time),
      Number("synchronization_lag", 0.001, 10, &e.sync_lag),
      Number("synchronization_torque_share", 0, 1, &e.sync_torque_share),
      Number("synchronization_brake_share", 0, 1, &e.sync_brake_share),
      Number("engine_brake_power", 0, 1e7, &e.brake_power),
      Number("engine_brake_speed", 50, 1000, &e.brake_speed),
      Number("engine_brake_exponent", 0, 4, &e.brake_exponent),
      Number("engine_brake_speed_min", 0, 1000, &e.brake_speed_min),
      Number("engine_brake_fade", 0.1, 1000, &e.brake_fade),
      Number("engine_brake_lag", 0.001, 10, &e.brake_lag),
      Number("engine_brake_release_lag", 0.001, 10, &e.brake_release_lag),
      Together("fuel_map_torque", Number("idle_fuel_rate", 0, 1, &e.idle_fuel_rate)),
      Axis("full_load_speed", &e.full_load.x),
      Values("full_load_torque", 0, 1e5, &e.full_load.y, {&e.full_load.x}),
      Axis("drag_speed", &e.drag.x),
      Values("drag_torque", 0, 1e5, &e.drag.y, {&e.drag.x}),
      Axis("pedal_map_speed", &e.pedal_map.rows),
      Axis("pedal_map_pedal", &e.pedal_map.columns),
      Values("pedal_map_torque", 0, 1e5, &e.pedal_map.values,
             {&e.pedal_map.rows, &e.pedal_map.columns}),
      Optional(Axis("fuel_map_torque", &e.fuel_map.rows)),
      Together("fuel_map_torque", Axis("fuel_map_speed", &e.fuel_map.columns)),
      Together("fuel_map_torque", Values("fuel_map_consumption", 0, 1, &e.fuel_map.values,
                                         {&e.fuel_map.rows, &e.fuel_map.columns})),
      Optional(Axis("fuel_rate_torque", &e.fuel_rate.rows)),
      Together("fuel_rate_torque", Axis("fuel_rate_speed", &e.fuel_rate.columns)),
      Together("fuel_rate_torque", Values("fuel_rate_values", 0, 1, &e.fuel_rate.values,
                                          {&e.fuel_rate.rows, &e.fuel_rate.columns})),
      Optional(Number("fuel_factor", 0, 10, &e.fuel_factor)),
      Optional(Number("auxiliary_power", 0, 1e5, &e.auxiliary_power)),
      // Retarder, and the brakes' cut of the accelerator.
      Number("retarder_torque_max", 0, 1e5, &r.torque_max),
      Number("retarder_full_torque_speed", 1, 1000, &r.full_torque_speed),
      Number("retarder_power_max", 1, 1e7, &r.power_max),
      Number("retarder_power_continuous", 1, 1e7, &r.power_continuous),
      Number("retarder_heat_time", 0.1, 1e4, &r.heat_time),
      Number("retarder_derate_heat", 0, 0.99, &r.derate_heat),
      Number("retarder_fill_time", 0.001, 10, &r.fill_time),
      Number("retarder_empty_time", 0.001, 10, &r.empty_time),
      Optional(Ordered("retarder_drag_speed", 1, 2, 64, 0, 1e4, &g.retarder_drag.x)),
      Together("retarder_drag_speed",
               Values("retarder_drag_torque", 0, 1e4, &g.retarder_drag.y, {&g.retarder_drag.x})),
      Number("pedal_return_time", 0.001, 60, &law_.endurance.return_time),
      // Gearbox.
      Ordered("ratios", -1, 2, 32, 0.05, 200, &g.ratios),
      Values("gear_inertias", 0, 100, &g.inertias, {&g.ratios}),
      Number("reverse_ratio", 0.1, 100, &g.reverse_ratio),
      Number("final_drive", 0.1, 20, &g.final_drive),
      // One for all gears, or one per gear.
      {"efficiency",
       [&g](const mjModel* m, int instance, const char* name) {
         const size_t gears = g.ratios.size();
         if (!ReadNumbers(m, instance, name, 1, gears, 0.5, 1, &g.efficiencies)) return false;
         const size_t given = g.efficiencies.size();
         if (given == 1) g.efficiencies.resize(gears, g.efficiencies[0]);
         return g.efficiencies.size() == gears ||
                Refuse(m, instance, "attribute '%s' has %zu numbers; allowed are 1 or %zu", name,
                       given, gears);
       }},
      Optional(Ordered("gear_loss_speed", 1, 2, 64, 0, 1e4, &gear_loss_.rows)),
      Together("gear_loss_speed", Axis("gear_loss_torque", &gear_loss_.columns)),
      Together("gear_loss_speed",
               {"gear_losses", [this](const mjModel* m, int instance,
                                      const char* key) { return ReadLossMaps(m, instance, key); }}),
      Together("gear_loss_speed", Values("gear_loss_map", 0, 32, &gear_loss_map_, {&g.ratios})),
      Optional(Ordered("axle_loss_speed", 1, 2, 64, 0, 1e4, &g.axle_loss.rows)),
      Together("axle_loss_speed", Axis("axle_loss_torque", &g.axle_loss.columns)),
      Together("axle_loss_speed", Values("axle_losses", 0, 1e5, &g.axle_loss.values,
                                         {&g.axle_loss.rows, &g.axle_loss.columns})),
      Number("wheel_radius", 0.05, 5, &wheel_radius_),
      Number("shift_cut_time", 0.001, 5, &b.cut_time),
      Number("synchronization_time", 0.001, 5, &b.synchronization_time),
      Number("synchronization_time_max", 0.001, 5, &b.synchronization_limit),
      Number("synchronized_difference", 0.1, 100, &b.synchronized_difference),
      Number("clutch_close_time", 0.001, 5, &b.close_time),
      // Shift strategy.
      Text("shift_strategy", &shift_strategy_),
      Number("start_gear", 1, 32, &s.start_gear),
      Number("downshift_delay", 0, 10, &s.downshift_delay),
      Number("downshift_margin", 0, 20, &s.downshift_margin),
      Number("min_gear_time", 0, 20, &s.min_gear_time),
      Number("reversal_time", 0, 60, &s.reversal_time),
      Optional(Axis("upshift_gear", &s.upshift.rows)),
      Together("upshift_gear", Axis("upshift_pedal", &s.upshift.columns)),
      Together("upshift_gear", Values("upshift_speed", 0, 200, &s.upshift.values,
                                      {&s.upshift.rows, &s.upshift.columns})),
      Optional(Axis("downshift_gear", &s.downshift.rows)),
      Together("downshift_gear", Axis("downshift_pedal", &s.downshift.columns)),
      Together("downshift_gear", Values("downshift_speed", 0, 200, &s.downshift.values,
                                        {&s.downshift.rows, &s.downshift.columns})),
      Number("acceleration_lag", 0.001, 10, &s.acceleration_lag),
      Number("load_lag", 0.001, 10, &s.load_lag),
      Number("pedal_lag", 0.001, 20, &s.pedal_lag),
      Number("lowest_speed", 1, 3, &s.lowest_speed),
      Number("lowest_speed_pedal", 0, 3, &s.lowest_speed_pedal),
      Number("rolling_speed", 1, 4, &s.rolling_speed),
      Number("recovery_horizon", 0, 10, &s.recovery_horizon),
      Number("recovery_speed", 0.5, 3, &s.recovery_speed),
      Number("relaunch_speed", 0, 3, &s.relaunch_speed),
      Number("recovery_time", 0, 10, &s.recovery_time),
      Number("upshift_speed_margin", 1, 2, &s.upshift_speed),
      Number("downshift_speed_margin", 1, 2, &s.downshift_speed),
      Number("downshift_speed_max", 0.1, 1, &s.downshift_speed_max),
      Number("power_speed", 1, 5, &s.power_speed),
      Number("overspeed", 1, 2, &s.overspeed),
      Number("overspeed_braking", 1, 2, &s.overspeed_braking),
      Number("torque_reserve", 1, 3, &s.torque_reserve),
      Number("failed_reserve", 1, 3, &s.failed_reserve),
      Number("failed_load", 0, 1, &s.failed_load),
      Number("built_up_torque", 0, 1, &s.built_up_torque),
      Number("stuck_acceleration", 0, 5, &s.stuck_acceleration),
      Number("first_gear_delay", 0, 20, &s.first_gear_delay),
      Number("engage_speed_max", 0, 20, &s.engage_speed_max),
      Number("floored_pedal", 0.1, 1, &s.floored_pedal),
      Number("kick_down_pedal", 0.1, 1, &s.kick_down_pedal),
      Number("kick_down_rise", 0, 1, &s.kick_down_rise),
      Number("kick_down_speed", 0.1, 1, &s.kick_down_speed),
      Number("skip_up_max", 1, 32, &s.skip_up_max),
      Number("skip_down_max", 1, 32, &s.skip_down_max),
      Number("braking_speed_low", 0.1, 1, &s.braking_speed_low),
      Number("braking_speed_high", 0.1, 1, &s.braking_speed_high),
      Number("braking_deceleration", 0, 20, &s.braking_deceleration),
      Number("adaptive_period", 0, 5, &s.adaptive_period),
      Number("adaptive_reserve", 1, 3, &s.adaptive_reserve),
      Number("adaptive_gain", 0, 1, &s.adaptive_gain),
      Number("adaptive_speed_max", 0.1, 1, &s.adaptive_speed_max),
      Number("adaptive_horizon", 1, 120, &s.adaptive_horizon),
      Number("adaptive_time_price", 0, 1, &s.adaptive_time_price),
      Number("adaptive_climb_speed", 0.3, 1, &s.adaptive_climb_speed),
      // Clutch and driveline.
      Number("clutch_engagement_time", 0.01, 10, &c.engagement_time),
      Number("clutch_opening_time", 0.01, 10, &c.opening_time),
      Number("clutch_torque_max", 1, 1e6, &d.torque_max),
      Number("clutch_launch_range", 0.1, 1000, &c.launch_range),
      Number("clutch_alike_range", 0, 1000, &c.alike_range),
      Number("clutch_release_share", 0, 2, &c.release_share),
      Number("clutch_release_share_coast", 0, 2, &c.release_share_coast),
      Number("clutch_stall_share", 0, 1, &c.stall_share),
      Number("clutch_stall_range", 0.001, 1, &c.stall_range),
      Number("driveline_efficiency", 0.5, 1, &g.driveline_efficiency),
      Number("driveline_stiffness", 1, 1e9, &d.stiffness),
      Number("driveline_damping", 1, 1e9, &d.damping),
      Number("loss_reversal_speed", 1e-3, 100, &d.loss_reversal_speed),
  };
}

bool PowertrainPlugin::Bind(const mjModel* m, int instance) {
  if (!FindActuators(m, instance) || !FindSensors(m, instance)) return false;
  if (!ReadAttributes(m, instance, Table()) || !Check(m, instance)) return false;
  // The driven wheels are those of the tendon.
  const double gear = m->actuator_gear[6 * pedal_];
  for (const auto& [dof, coefficient] : TendonDofs(m, pedal_)) {
    wheels_.emplace_back(dof, gear * coefficient);
  }
  if (!wheels_.empty()) body_ = m->dof_bodyid[wheels_[0].first];
  Prepare();
  return true;
}

// One block of speed x torque for each map.
bool PowertrainPlugin::ReadLossMaps(const mjModel* m, int instance, const char* name) {
  const size_t size = gear_loss_.rows.size() * gear_loss_.columns.size();
  const size_t most = size * law_.gearbox.gears.ratios.size();
  std::vector<double> losses;
  if (!ReadNumbers(m, instance, name, size, most, 0, 1e5, &losses)) return false;
  if (losses.size() % size) {
    return Refuse(m, instance, "attribute '%s' has %zu numbers; allowed are multiples of %zu", name,
                  losses.size(), size);
  }
  for (auto map = losses.begin(); map != losses.end(); map += size) {
    gear_loss_.values.assign(map, map + size);
    law_.gearbox.gears.loss_maps.push_back(gear_loss_);
  }
  return true;
}

// Bounds that depend on other attributes.
bool PowertrainPlugin::Check(const mjModel* m, int instance) const {
  const Engine<double>& e = law_.engine;
  const Retarder<double>& r = law_.retarder;
  const size_t maps = law_.gearbox.gears.loss_maps.size();
  const ShiftParameters<double>& s = law_.gearbox.strategy;
  const int start_gear = s.start_gear, gears = law_.gearbox.gears.count();
  if (e.governed_speed <= 1.2 * e.idle_speed) {
    return Refuse(m, instance, "governed_speed %g must exceed 1.2 times idle_speed %g",
                  e.governed_speed, e.idle_speed);
  }
  if (r.power_continuous > r.power_max) {
    return Refuse(m, instance, "retarder_power_continuous %g must not exceed retarder_power_max %g",
                  r.power_continuous, r.power_max);
  }
  if (start_gear > gears) {
    return Refuse(m, instance, "start_gear %d must not exceed the number of gears, %d", start_gear,
                  gears);
  }
  for (double map : gear_loss_map_) {
    if (map <= static_cast<double>(maps)) continue;
    return Refuse(m, instance, "gear_loss_map %g must not exceed the number of gear_losses, %zu",
                  map, maps);
  }
  if (shift_strategy_ != "tables" && shift_strategy_ != "adaptive") {
    return Refuse(m, instance, "shift_strategy '%s' is not one of tables, adaptive",
                  shift_strategy_.c_str());
  }
  if (shift_strategy_ == "tables" && (s.upshift.rows.empty() || s.downshift.rows.empty())) {
    return Refuse(m, instance, "shift_strategy 'tables' needs upshift_gear and downshift_gear");
  }
  if (e.fuel_map.rows.empty() == e.fuel_rate.rows.empty()) {
    return Refuse(m, instance, "needs either fuel_map_torque or fuel_rate_torque");
  }
  return true;
}

// Computes the constants that depend on the attributes.
void PowertrainPlugin::Prepare() {
  Engine<double>& engine = law_.engine;
  Gearbox<double>& box = law_.gearbox;
  Driveline<double>& line = law_.driveline;
  engine.Prepare();
  law_.endurance.pedal_up = engine.pedal_up;
  box.gears.map_of_gear.assign(gear_loss_map_.begin(), gear_loss_map_.end());
  box.gears.meters_per_radian = wheel_radius_ / box.gears.final_drive;
  box.strategy.cut_time = box.cut_time;
  box.strategy.launch_range = line.control.launch_range;
  box.strategy.change_time = box.cut_time + box.synchronization_time + box.close_time;
  box.strategy.adaptive = shift_strategy_ == "adaptive";
  line.control.idle_speed = engine.idle_speed;
  line.control.pedal_up = engine.pedal_up;
  line.control.launch_share = Min(1.0, engine.reference_torque / line.torque_max);
  // The attributes apply at the wheels.
  line.stiffness /= box.gears.final_drive * box.gears.final_drive;
  line.damping /= box.gears.final_drive * box.gears.final_drive;
}

bool PowertrainPlugin::FindActuators(const mjModel* m, int instance) {
  const LocalNames names(m, instance, kAnchor);
  if (!FindActuatorsByName(m, instance, names,
                           {{kAnchor, &pedal_},
                            {"engine_brake", &engine_brake_},
                            {"retarder", &retarder_lever_},
                            {"transmission_mode", &mode_}})) {
    return false;
  }
  if (pedal_ < 0 || m->actuator_trntype[pedal_] != mjTRN_TENDON) {
    return Refuse(m, instance,
                  "needs the actuator accelerator_pedal with a fixed tendon over the driven wheels "
                  "as its transmission");
  }
  air_brake_ = PartnerInstance(m, names.Whole("xbr_demand"), "iits.air_brake");
  return true;
}

bool PowertrainPlugin::FindSensors(const mjModel* m, int instance) {
  const LocalNames names(m, instance, kAnchor);
  for (int i : SensorsOfInstance(m, instance)) {
    const std::string name = names.Of(m, mjOBJ_SENSOR, i);
    const size_t before = sensors_.size();
    std::string known = kReport;
    for (int k = 0; k < (name == kReport ? kReportSize : 0); ++k) {
      sensors_.emplace_back(m->sensor_adr[i] + k, kReportPlace + k);
    }
    for (const auto& signal : kSignals) {
      known += ", " + std::string(signal.name);
      if (name == signal.name) {
        sensors_.emplace_back(m->sensor_adr[i], static_cast<int>(signal.place));
      }
    }
    if (sensors_.size() == before) {
      return Refuse(m, instance, "sensor '%s' is unknown; known are %s", name.c_str(),
                    known.c_str());
    }
  }
  return true;
}

void PowertrainPlugin::Actuator(const mjModel* m, mjData* d, State* s) const {
  PowertrainControls<double> controls;
  controls.levers = {Control(m, d, pedal_, 0, 1), Control(m, d, engine_brake_, 0, 1),
                     Control(m, d, retarder_lever_, 0, 1)};
  // Rounded; std::lround is a function call.
  using Input = GearboxInput<double>;
  const int mode = static_cast<int>(Control(m, d, mode_, 0, kLastMode) + 0.5);
  controls.requested_gear = std::max(mode - Input::kReverse, 0);
  controls.mode = controls.requested_gear ? Input::kDrive : static_cast<Input::Mode>(mode);
  controls.demand = ReadPartner<EnduranceDemand<double>>(m, d, air_brake_);
  // Mass of the kinematic tree of the first driven wheel. Read in every step: the masses may
  // change, and in rollouts several models share one plugin object.
  controls.mass = body_ < 0 ? 0 : m->body_subtreemass[m->body_rootid[body_]];
  law_.Step(controls, ShaftSpeed(d), m->opt.timestep, s);
  // MuJoCo has set the forces of all actuators to zero.
  d->actuator_force[m->actuator_outadr[pedal_]] = s->next.shaft_torque;
}

}  // namespace

void RegisterPowertrain() {
  RegisterPlugin<PowertrainPlugin>("iits.powertrain", mjPLUGIN_ACTUATOR | mjPLUGIN_SENSOR);
}

}  // namespace iits
