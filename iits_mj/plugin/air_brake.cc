// Air brake plugin `iits.air_brake`. Hubs (the bodies that do not spin) reference the instance: in
// body order, left and right of each axle, each with one child body on one hinge, the wheel.
// Actuators, by local name: `xbr_demand`, `xbr_mode` and optionally `parking_brake`, `brake_pedal`,
// `xbr_ebi_mode`; they exert no force themselves. If the transmission of `xbr_demand` is a fixed
// tendon over driven wheels, the tendon is the propeller shaft, and an `iits.powertrain` with the
// same name prefix contributes to braking.
#include "plugin/laws/air_brake.h"

#include <cmath>
#include <cstddef>
#include <string>

#include "plugin/parts.h"
#include "plugin/plugin.h"
#include "plugin/spatial.h"

namespace iits {
namespace {

using Demand = BrakeDemand<double>;
using Wheel = WheelBrake<double>;

const char* const kCircuitNames[kCircuits] = {"front", "rear", "trailer"};
const char* const kPressures = "brake_pressures";
const char* const kTorques = "brake_torques";
const char* const kSpeeds = "wheel_speeds";
const char* const kSlipControl = "slip_control_active";
constexpr int kSlipControls = 3;  // by engine, by brakes, of the drag torque
const char* const kAnchor = "xbr_demand";
const char* const kSides[2] = {"_left", "_right"};

// Of SPN 2920 [m/s2]: resolution and range.
constexpr double kDemandMin = 1. / 2048, kDemandMax = 15.687;

class AirBrakePlugin : public PluginBase {
 public:
  using State = AirBrakeState<double>;

  // Some sensors have a number per wheel, because each sensor costs time in MuJoCo.
  static int SensorSize(const mjModel* m, int instance, int sensor) {
    const std::string name = LocalNames(m, instance, kAnchor).Of(m, mjOBJ_SENSOR, sensor);
    if (name == kSlipControl) return kSlipControls;
    const bool per_wheel = name == kPressures || name == kTorques || name == kSpeeds;
    return per_wheel ? static_cast<int>(BodiesOfInstance(m, instance).size()) : 1;
  }

  Attributes Table();
  bool Bind(const mjModel* m, int instance);
  // Sensors show the charged reservoirs before the first step, too.
  void Reset(State* s) const { law_.reservoirs.Fill(&s->now.reservoir); }
  void Passive(const mjModel* m, mjData* d, State* s) const;
  void Actuator(const mjModel* m, mjData* d, State* s) const {
    Actuate(m, d, [this, m, d](size_t i) { return HubSpeed(m, d, i); }, s);
  }
  // Pressures of the next step from the controls of this one; `hub_speed(i)` returns the forward
  // speed of a hub.
  template <class Speed>
  void Actuate(const mjModel* m, mjData* d, const Speed& hub_speed, State* s) const;
  void Sensors(const mjModel* m, mjData* d, const State* s) const;

  void Advance(const mjModel* m, mjData* d, State* s) const {
    law_.Commit(m->opt.timestep, [this, d](size_t i) { return d->qvel[dofs_[i]]; }, s);
  }

 private:
  // A sensor's value is the mean of some numbers of the state, 0 without any.
  struct Sensor {
    int address;
    int begin, end;  // range in places_, the indices of these numbers in the state
    double share;    // weight of each
  };

  bool FindHubs(const mjModel* m, int instance);
  bool FindActuators(const mjModel* m, int instance);
  void FindShaft(const mjModel* m);
  bool FindSensors(const mjModel* m, int instance);
  bool FindSignal(const std::string& name);
  bool Check(const mjModel* m, int instance) const;

  // Speed of the hub along its own x axis.
  double HubSpeed(const mjModel* m, const mjData* d, size_t i) const {
    const int hub = hubs_[i];
    mjtNum linear[3], angular[3];
    PointVelocity(m, d, hub, d->xpos + 3 * hub, linear, angular);
    const mjtNum* frame = d->xmat + 9 * hub;
    return frame[0] * linear[0] + frame[3] * linear[1] + frame[6] * linear[2];
  }

  AirBrake<double> law_;
  std::vector<int> hubs_, dofs_;  // of each wheel: body that does not spin, degree of freedom
  double trailer_delay_ = 0;
  int demand_ = -1, mode_ = -1, parking_ = -1, pedal_ = -1, ebi_mode_ = -1;  // actuators
  int powertrain_ = -1;                                                      // instance
  std::vector<Sensor> sensors_;
  std::vector<int> places_;
  int speeds_ = -1;  // address of the sensor `wheel_speeds` in sensordata
};

Attributes AirBrakePlugin::Table() {
  // Attributes with one number per axle, and with one number for all wheels.
  auto per_axle = [this](const char* name, double low, double high, auto member) -> Attribute {
    return {name, [=](const mjModel* m, int instance, const char* key) {
              const size_t axles = law_.wheels.size() / 2;
              std::vector<double> values;
              if (!ReadNumbers(m, instance, key, axles, axles, low, high, &values)) return false;
              for (size_t i = 0; i < 2 * axles; ++i) law_.wheels[i].*member = values[i / 2];
              return true;
            }};
  };
  auto common = [this](const char* name, double low, double high,
                       double Wheel::* member) -> Attribute {
    return {name, [=](const mjModel* m, int instance, const char* key) {
              double value;
              if (!Number(key, low, high, &value).read(m, instance, key)) return false;
              for (Wheel& wheel : law_.wheels) wheel.*member = value;
              return true;
            }};
  };
  BrakeControl<double>& c = law_.control;
  BrakeDistribution<double>& d = c.distribution;
  Reservoirs<double>& r = law_.reservoirs;
  DriveSlipControl<double>& slip = law_.drive_slip;
  return {
      // Axles.
      per_axle("circuit", 0, kCircuits - 1, &Wheel::circuit),
      per_axle("dead_time", 0, 2, &Wheel::dead_time),
      per_axle("build_up_time_constant", 0.001, 10, &Wheel::build_up_time_constant),
      per_axle("release_time_constant", 0.001, 10, &Wheel::release_time_constant),
      per_axle("torque_per_pressure", 0, 10, &Wheel::torque_per_pressure),
      per_axle("parking_torque", 0, 1e6, &Wheel::parking_torque),
      per_axle("wheel_radius", 0.05, 5, &Wheel::wheel_radius),
      per_axle("chamber_volume", 0, 1, &Wheel::chamber_volume),
      Optional(per_axle("lifted", 0, 1, &Wheel::lifted)),
      // Wheel ends and lines.
      common("push_out_pressure", 1, 1e6, &Wheel::push_out_pressure),
      common("hysteresis_pressure", 1, 1e6, &Wheel::hysteresis_pressure),
      common("abs_release_slip", 0.01, 1, &Wheel::abs_release_slip),
      common("abs_reapply_slip", 0, 1, &Wheel::abs_reapply_slip),
      common("abs_speed_min", 0.1, 100, &Wheel::abs_speed_min),
      common("abs_time_constant", 0.001, 10, &Wheel::abs_time_constant),
      common("abs_yaw_share", 1, 100, &Wheel::abs_yaw_share),
      common("abs_yaw_rise_rate", 1, 1e9, &Wheel::abs_yaw_rise_rate),
      common("abs_pressure_lag", 0.001, 100, &Wheel::abs_pressure_lag),
      common("abs_refill_share", 0, 1, &Wheel::abs_refill_share),
      common("abs_rise_time", 0.001, 1000, &Wheel::abs_rise_time),
      common("abs_slip_lag", 0.001, 1, &Wheel::abs_slip_lag),
      common("abs_slip_lead", 0, 1, &Wheel::abs_slip_lead),
      common("abs_speed_low", 0.1, 100, &Wheel::abs_speed_low),
      common("stiffness", 1, 1e9, &Wheel::stiffness),
      Number("trailer_line_delay", 0, 2, &trailer_delay_),
      // Slip of the driven wheels.
      Number("drive_slip_lag", 0.001, 1, &slip.lag),
      Number("drive_slip_lead", 0, 1, &slip.lead),
      Number("drag_slip_begin", 0.001, 1, &slip.drag.begin),
      Number("drag_slip_end", 0, 1, &slip.drag.end),
      Number("drag_release_time", 0.001, 100, &slip.drag.release_time),
      Number("drag_return_time", 0.001, 100, &slip.drag.return_time),
      Number("asr_slip_begin", 0.001, 10, &slip.traction.begin),
      Number("asr_slip_end", 0, 10, &slip.traction.end),
      Number("asr_release_time", 0.001, 100, &slip.traction.release_time),
      Number("asr_return_time", 0.001, 100, &slip.traction.return_time),
      Number("asr_hold_time", 0.001, 100, &slip.hold_time),
      Number("asr_slip_range", 0.001, 10, &slip.range),
      Number("asr_brake_speed", 0, 100, &slip.brake_speed),
      Number("asr_brake_pressure", 0, 1e8, &slip.brake_pressure),
      Number("parking_time_constant", 0.001, 10, &law_.parking_time_constant),
      // Control.
      Number("supply_rise_rate", 1, 1e9, &c.rise_rate),
      Number("supply_fall_rate", 1, 1e9, &c.fall_rate),
      Number("pressure_max", 1, 1e8, &c.pressure_max),
      Number("release_rate", 0.01, 1e6, &c.release_rate),
      Number("pedal_deceleration", 0, 100, &c.pedal_deceleration),
      Number("rolling_resistance", 0, 1, &c.rolling_resistance),
      Number("filter_time_constant", 0.001, 10, &c.filter_time),
      Number("trim_gain", 0, 10, &c.trim_gain),
      Number("trim_max", 0, 10, &c.trim_max),
      Number("trim_share", 0, 1, &c.trim_share),
      Number("trim_speed_min", 0, 100, &c.trim_speed_min),
      Number("hysteresis_time_constant", 0.001, 10, &c.hysteresis_time),
      Number("endurance_speed_off", 0, 100, &c.shaft_speed_off),
      Number("endurance_speed_on", 0, 100, &c.shaft_speed_on),
      Number("endurance_rate", 0.01, 1e6, &c.endurance_rate),
      Number("hold_speed", 0, 10, &c.hold_speed),
      Number("hold_deceleration", 0, 10, &c.hold_deceleration),
      Number("hold_release_speed", 0, 10, &c.hold_release_speed),
      Number("hill_hold_time", 0, 60, &c.hold_time_max),
      Number("hill_hold_min", 0, 10, &c.hold_uphill),
      // Distribution.
      Number("mass_light", 1, 1e6, &d.mass_light),
      Number("mass_heavy", 1, 1e6, &d.mass_heavy),
      Ordered("demand", 1, 2, 1000, 0, 1000, &d.demand),
      Values("share_light", 0, 1, &d.light, {&d.demand}, kCircuits),
      Values("share_heavy", 0, 1, &d.heavy, {&d.demand}, kCircuits),
      // Air supply.
      {"reservoir_volume",
       [&r](const mjModel* m, int instance, const char* name) {
         std::vector<double> volume;
         if (!ReadNumbers(m, instance, name, kCircuits, kCircuits, 0, 100, &volume)) {
           return false;
         }
         std::copy(volume.begin(), volume.end(), r.volume);
         return true;
       }},
      Number("compressor_displacement", 0, 1, &r.displacement),
      Number("governor_cut_in", 0, 1e8, &r.cut_in),
      Number("governor_cut_out", 1, 1e8, &r.cut_out),
      Number("spring_begin_pressure", 1, 1e8, &r.spring_begin),
      Number("spring_full_pressure", 0, 1e8, &r.spring_full),
  };
}

bool AirBrakePlugin::Bind(const mjModel* m, int instance) {
  if (!FindActuators(m, instance) || !FindHubs(m, instance)) return false;
  if (!ReadAttributes(m, instance, Table()) || !Check(m, instance)) return false;
  for (Wheel& wheel : law_.wheels) {
    if (wheel.circuit == kTrailer) wheel.dead_time += trailer_delay_;
  }
  law_.control.distribution.push_out = law_.wheels[0].push_out_pressure;
  law_.control.hysteresis = law_.wheels[0].hysteresis_pressure;
  law_.Prepare(m->opt.timestep);
  law_.drive_slip.low_speed = law_.wheels[0].abs_speed_low;
  FindShaft(m);
  return FindSensors(m, instance);
}

// Bounds that depend on other attributes.
bool AirBrakePlugin::Check(const mjModel* m, int instance) const {
  for (const Wheel& wheel : law_.wheels) {
    if (law_.reservoirs.volume[wheel.circuit] >= 1e-4) continue;
    return Refuse(m, instance, "reservoir_volume %g of circuit %d, which has wheels, is below 1e-4",
                  law_.reservoirs.volume[wheel.circuit], wheel.circuit);
  }
  const Wheel& wheel = law_.wheels[0];
  const BrakeControl<double>& c = law_.control;
  const BrakeDistribution<double>& d = c.distribution;
  const Reservoirs<double>& r = law_.reservoirs;
  if (wheel.abs_reapply_slip >= wheel.abs_release_slip) {
    return Refuse(m, instance, "abs_reapply_slip %g must be less than abs_release_slip %g",
                  wheel.abs_reapply_slip, wheel.abs_release_slip);
  }
  const SlipReliefLaw<double>&drag = law_.drive_slip.drag, &asr = law_.drive_slip.traction;
  if (drag.end >= drag.begin || asr.end >= asr.begin) {
    return Refuse(m, instance,
                  "drag_slip_end %g must be less than drag_slip_begin %g, and asr_slip_end %g less "
                  "than asr_slip_begin %g",
                  drag.end, drag.begin, asr.end, asr.begin);
  }
  if (c.shaft_speed_on <= c.shaft_speed_off) {
    return Refuse(m, instance, "endurance_speed_on %g must exceed endurance_speed_off %g",
                  c.shaft_speed_on, c.shaft_speed_off);
  }
  if (d.mass_heavy <= d.mass_light) {
    return Refuse(m, instance, "mass_heavy %g must exceed mass_light %g", d.mass_heavy,
                  d.mass_light);
  }
  if (r.cut_in >= r.cut_out || r.spring_full >= r.spring_begin || r.spring_begin >= r.cut_in) {
    return Refuse(m, instance,
                  "attributes must have spring_full_pressure < spring_begin_pressure < "
                  "governor_cut_in < governor_cut_out; they are %g, %g, %g, %g",
                  r.spring_full, r.spring_begin, r.cut_in, r.cut_out);
  }
  return true;
}

bool AirBrakePlugin::FindHubs(const mjModel* m, int instance) {
  hubs_ = BodiesOfInstance(m, instance);
  if (hubs_.size() < 2 || hubs_.size() > kWheelsMax || hubs_.size() % 2) {
    return Refuse(m, instance, "%zu hub bodies reference it; allowed are 2 to %d, two an axle",
                  hubs_.size(), kWheelsMax);
  }
  for (int hub : hubs_) {
    int children = 0, dof = -1;
    for (int body = 1; body < m->nbody; ++body) {
      if (m->body_parentid[body] != hub) continue;
      ++children;
      const int joint = m->body_jntadr[body];
      if (m->body_jntnum[body] == 1 && m->jnt_type[joint] == mjJNT_HINGE) {
        dof = m->jnt_dofadr[joint];
      }
    }
    if (dof < 0 || children != 1) {
      const char* name = mj_id2name(m, mjOBJ_BODY, hub);
      return Refuse(m, instance, "hub body '%s' must have one child, a wheel on one hinge",
                    name ? name : "");
    }
    dofs_.push_back(dof);
    law_.wheels.emplace_back().inertia = m->dof_M0[dof];
  }
  return true;
}

bool AirBrakePlugin::FindActuators(const mjModel* m, int instance) {
  const LocalNames names(m, instance, kAnchor);
  if (!FindActuatorsByName(m, instance, names,
                           {{kAnchor, &demand_},
                            {"xbr_mode", &mode_},
                            {"parking_brake", &parking_},
                            {"brake_pedal", &pedal_},
                            {"xbr_ebi_mode", &ebi_mode_}})) {
    return false;
  }
  if (demand_ < 0 || mode_ < 0) {
    return Refuse(m, instance, "needs the actuators xbr_demand and xbr_mode");
  }
  powertrain_ = PartnerInstance(m, names.Whole("accelerator_pedal"), "iits.powertrain");
  return true;
}

// The shaft speed is the sum of the wheel speeds times their coefficients, which contain the final
// drive.
void AirBrakePlugin::FindShaft(const mjModel* m) {
  if (powertrain_ < 0 || m->actuator_trntype[demand_] != mjTRN_TENDON) return;
  for (const auto& [dof, coefficient] : TendonDofs(m, demand_)) {
    for (size_t k = 0; k < dofs_.size(); ++k) {
      if (dofs_[k] != dof || law_.wheels[k].lifted) continue;
      law_.shaft_ratio += coefficient / law_.wheels[k].wheel_radius;
      law_.driven.push_back(k);
    }
  }
}

int Place(size_t offset) { return static_cast<int>(offset / sizeof(mjtNum)); }

using State = AirBrakePlugin::State;
using Pneumatics = BrakePneumatics<double>;
using Air = ReservoirState<double>;
using Chamber = WheelBrakeState<double>;

// Index of a chamber's pressure in the state.
int Pressure(size_t wheel) {
  return Place(offsetof(State, now) + offsetof(Pneumatics, wheel) + wheel * sizeof(Chamber) +
               offsetof(Chamber, pressure));
}

constexpr size_t kReservoir = offsetof(State, now) + offsetof(Pneumatics, reservoir);

int ReservoirPressure(size_t circuit) {
  return Place(kReservoir + offsetof(Air, pressure) + circuit * sizeof(mjtNum));
}

// Of the present step, as the other forces of sensors.
int Torque(size_t wheel) {
  return Place(offsetof(State, next_wind_up) + offsetof(BrakeWindUp<double>, torque) +
               wheel * sizeof(mjtNum));
}

const struct {
  const char* name;
  size_t offset;
} kSingles[] = {
    {"xbr_active", offsetof(State, xbr_active)},
    {"abs_active", offsetof(State, abs_active)},
    {"brake_work", offsetof(State, work)},
    {"endurance_torque_demand", offsetof(State, endurance)},
    {"compressor_active", kReservoir + offsetof(Air, pumping)},
};
static_assert(offsetof(EnduranceDemand<double>, shaft_torque) == 0,
              "endurance_torque_demand shows it");

// Appends indices by the sensor's local name; false if there is no signal of this name.
bool AirBrakePlugin::FindSignal(const std::string& name) {
  for (const auto& single : kSingles) {
    if (name != single.name) continue;
    places_.push_back(Place(single.offset));
    return true;
  }
  for (int i = 0; i < kCircuits; ++i) {
    if (name != std::string("reservoir_pressure_") + kCircuitNames[i]) continue;
    places_.push_back(ReservoirPressure(i));
    return true;
  }
  const std::string stem = "brake_pressure_";
  bool found[kCircuits] = {};  // a circuit's pressure is that of its first axle
  for (size_t i = 0; i < hubs_.size(); ++i) {
    const int circuit = law_.wheels[i].circuit;
    const std::string axle = "axle" + std::to_string(i / 2 + 1) + kSides[i % 2];
    const bool first = !found[circuit] && name == stem + kCircuitNames[circuit] + kSides[i % 2];
    if (first || name == stem + axle) {
      places_.push_back(Pressure(i));
      return true;
    }
    if (i % 2) found[circuit] = true;
  }
  if (name != stem + "trailer") return false;
  for (size_t i = 0; i < hubs_.size(); ++i) {
    if (law_.wheels[i].circuit == kTrailer) places_.push_back(Pressure(i));
  }
  return true;
}

bool AirBrakePlugin::FindSensors(const mjModel* m, int instance) {
  const LocalNames names(m, instance, kAnchor);
  for (int i : SensorsOfInstance(m, instance)) {
    const std::string name = names.Of(m, mjOBJ_SENSOR, i);
    if (name == kPressures || name == kTorques) {
      for (int k = 0; k < static_cast<int>(hubs_.size()); ++k) {
        const int begin = static_cast<int>(places_.size());
        places_.push_back(name == kPressures ? Pressure(k) : Torque(k));
        sensors_.push_back({m->sensor_adr[i] + k, begin, begin + 1, 1});
      }
      continue;
    }
    if (name == kSlipControl) {
      const int begin = static_cast<int>(places_.size());
      for (size_t offset : {offsetof(State, asr_engine_active), offsetof(State, asr_brake_active),
                            offsetof(State, drag_control_active)}) {
        const int at = static_cast<int>(places_.size());
        places_.push_back(Place(offset));
        sensors_.push_back({m->sensor_adr[i] + at - begin, at, at + 1, 1});
      }
      continue;
    }
    if (name == kSpeeds) {
      speeds_ = m->sensor_adr[i];
      continue;
    }
    const size_t begin = places_.size();
    if (!FindSignal(name)) {
      std::string known;
      for (const auto& single : kSingles) known += std::string(single.name) + ", ";
      return Refuse(m, instance,
                    "sensor '%s' is unknown; known are %s"
                    "reservoir_pressure_{front,rear,trailer}, "
                    "brake_pressure_{front,rear}_{left,right}, brake_pressure_trailer, "
                    "brake_pressure_axle{1..%zu}_{left,right}, %s, %s, %s, %s",
                    name.c_str(), known.c_str(), hubs_.size() / 2, kPressures, kTorques, kSpeeds,
                    kSlipControl);
    }
    const size_t count = places_.size() - begin;
    sensors_.push_back({m->sensor_adr[i], static_cast<int>(begin), static_cast<int>(places_.size()),
                        count ? 1. / count : 0});
  }
  return true;
}

void AirBrakePlugin::Sensors(const mjModel*, mjData* d, const State* s) const {
  const mjtNum* state = reinterpret_cast<const mjtNum*>(s);
  for (const Sensor& sensor : sensors_) {
    double sum = 0;
    for (int i = sensor.begin; i < sensor.end; ++i) sum += state[places_[i]];
    d->sensordata[sensor.address] = sum * sensor.share;
  }
  if (speeds_ < 0) return;
  for (size_t i = 0; i < dofs_.size(); ++i) {
    d->sensordata[speeds_ + i] = law_.Sensed(*s, i, d->qvel[dofs_[i]]);
  }
}

// Brake torque from the committed pressures.
void AirBrakePlugin::Passive(const mjModel* m, mjData* d, State* s) const {
  const double h = m->opt.timestep;
  double power = 0;
  for (size_t i = 0; i < dofs_.size(); ++i) {
    d->qfrc_passive[dofs_[i]] -= law_.Torque(i, d->qvel[dofs_[i]], h, s, &power);
  }
  s->next_work = 0.5 * h * power;
  s->next_wind_up_is_fresh = 1;
}

template <class Speed>
void AirBrakePlugin::Actuate(const mjModel* m, mjData* d, const Speed& hub_speed, State* s) const {
  auto wheel_speed = [this, d](size_t i) { return d->qvel[dofs_[i]]; };
  // The undefined fourth value of both two-bit fields acts as off and as friction only.
  auto field = [m, d](int actuator) {
    const long value = std::lround(Control(m, d, actuator, 0, 3));
    return value < 3 ? value : 0;
  };
  Demand demand = {};
  demand.xbr = -Control(m, d, demand_, -kDemandMax, 0);
  if (demand.xbr < kDemandMin) demand.xbr = 0;
  demand.xbr_mode = static_cast<Demand::XbrMode>(field(mode_));
  demand.ebi_mode = static_cast<Demand::EbiMode>(field(ebi_mode_));
  demand.pedal = Control(m, d, pedal_, 0, 1);
  demand.speed = 0.5 * (hub_speed(0) + hub_speed(1));
  // Read in every step, because the masses of the model may change.
  demand.mass = m->body_subtreemass[m->body_rootid[hubs_[0]]];
  demand.gravity = mju_norm3(m->opt.gravity);
  law_.Step(demand, ReadPartner<EnduranceState<double>>(m, d, powertrain_),
            Control(m, d, parking_, 0, 1), m->opt.timestep, hub_speed, wheel_speed, s);
}

}  // namespace

void ActuateAirBrake(const mjModel* m, mjData* d, int instance, const double* hub_speeds) {
  reinterpret_cast<const AirBrakePlugin*>(d->plugin_data[instance])
      ->Actuate(
          m, d, [hub_speeds](size_t i) { return hub_speeds[i]; },
          reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]));
}

void RegisterAirBrake() {
  RegisterPlugin<AirBrakePlugin>("iits.air_brake",
                                 mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE | mjPLUGIN_SENSOR);
}

}  // namespace iits
