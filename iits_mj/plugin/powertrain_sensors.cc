// Sensors of the powertrain: what its state says, by name.
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cstddef>
#include <string>

#include "plugin/config.h"
#include "plugin/powertrain.h"

namespace iits {
namespace {

using Output = Powertrain::Output;

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
};
#undef IITS_SIGNAL

// One sensor of several numbers, since each sensor costs MuJoCo time: from gear_engaged on.
const char* const kReport = "powertrain_report";
constexpr int kReportSize = 5;
static_assert(offsetof(Output, engine_load_percent) - offsetof(Output, gear_engaged) ==
                  (kReportSize - 1) * sizeof(mjtNum),
              "the numbers of powertrain_report lie side by side");

// Who has the say in the engine's torque (SPN 899).
enum TorqueMode { kNoRequest = 0, kAccelerator = 1, kTransmission = 6, kBrakes = 10 };

TorqueMode TorqueModeOf(const EngineRequest& request, double driver_pedal) {
  if (request.mode != EngineRequest::kPedal) return kTransmission;
  if (request.pedal < driver_pedal) return kBrakes;
  return driver_pedal > 0 ? kAccelerator : kNoRequest;
}

}  // namespace

bool Powertrain::FindSensors(const mjModel* m, int instance) {
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] != instance) continue;
    const std::string name = LocalName(mj_id2name(m, mjOBJ_SENSOR, i));
    if (name == kReport) {
      const int place = static_cast<int>(offsetof(Output, gear_engaged) / sizeof(mjtNum));
      for (int k = 0; k < kReportSize; ++k) sensors_.emplace_back(m->sensor_adr[i] + k, place + k);
      continue;
    }
    const size_t before = sensors_.size();
    std::string known = kReport;
    for (const auto& signal : kSignals) {
      known += ", " + std::string(signal.name);
      if (name == signal.name) {
        sensors_.emplace_back(m->sensor_adr[i], static_cast<int>(signal.place));
      }
    }
    if (sensors_.size() == before) {
      mju_warning("plugin instance '%s': sensor '%s' is unknown; known are %s",
                  InstanceName(m, instance).c_str(), name.c_str(), known.c_str());
      return false;
    }
  }
  return true;
}

// Sums are those of before the step, as positions and speeds are.
void Powertrain::ReportStart(const Core& core, Output* o) const {
  o->fuel_used = core.fuel_used;
  o->retarder_heat = core.retarder.heat;
  o->engine_work = core.energy.engine_work;
  o->clutch_loss = core.energy.clutch_loss;
  o->driveline_loss = core.energy.clutch_loss + core.energy.gear_loss;
  o->retarder_work = core.energy.retarder_work;
  o->driveline_energy = Driveline::Energy(core.driveline, core.engine.speed);
}

// Percent torques as J1939 counts them: of the reference torque of engine, engine brake or
// retarder; braking is negative.
void Powertrain::ReportStep(const EnginePoint& at, const EngineRequest& request,
                            const EnduranceCommand& command, double retarder_max, double pedal,
                            double driver_torque, State* s) const {
  const Core& core = s->next;
  Output* o = &s->output;
  const double of_reference = 100 / engine_.reference_torque();
  const double rated = engine_.rated_brake_torque();
  const double of_engine_brake = rated > 0 ? -100 / rated : 0;
  const double of_retarder = retarder_.torque_max() > 0 ? -100 / retarder_.torque_max() : 0;
  o->gear = core.gearbox.target;
  o->shift_in_process = core.gearbox.phase != Gearbox::kInGear;
  o->engine_speed = at.speed;
  o->engine_torque = engine_.BrakeTorque(at, core.engine);
  o->engine_torque_percent = of_reference * core.engine.torque;
  o->torque_loss_percent = of_reference * at.drag;
  o->engine_torque_percent_driver = of_reference * (driver_torque + at.drag);
  const double greatest = at.limit + at.drag;
  o->engine_load_percent = greatest > 0 ? 100 * std::min(1.0, core.engine.torque / greatest) : 0;
  o->engine_torque_mode = TorqueModeOf(request, pedal);
  o->fuel_rate = engine_.FuelRate(at, core.engine);
  o->clutch_engagement = core.driveline.engagement;
  o->propeller_shaft_torque = core.shaft_torque;
  o->propeller_shaft_speed = s->work.shaft_speed;
  o->accelerator_pedal_position = pedal;
  o->engine_brake_torque = core.engine.brake_torque;
  o->engine_brake_torque_percent = of_engine_brake * core.engine.brake_torque;
  o->engine_brake_torque_percent_intended = of_engine_brake * command.engine_brake * at.brake_max;
  o->engine_brake_torque_percent_available = of_engine_brake * at.brake_max;
  o->retarder_torque = core.retarder_torque;
  o->retarder_torque_percent = of_retarder * core.retarder_torque;
  o->retarder_torque_percent_intended = of_retarder * command.retarder_torque;
  o->retarder_torque_percent_available = of_retarder * retarder_max;
}

// While no gear is in, the gearbox's input turns with the engine, and the gear that was in last is
// still the current one (SPN 523).
void Powertrain::ReportGears(State* s) const {
  const GearboxState& gearbox = s->next.gearbox;
  const int gear = static_cast<int>(gearbox.gear);
  Output* o = &s->output;
  if (gear != 0 || gearbox.phase == Gearbox::kInGear) o->gear_engaged = gear;
  o->input_shaft_speed = gear ? gearbox_.Ratio(gear) * s->work.shaft_speed : o->engine_speed;
}

int Powertrain::SensorSize(const mjModel* m, int, int sensor) {
  return LocalName(mj_id2name(m, mjOBJ_SENSOR, sensor)) == kReport ? kReportSize : 1;
}

void Powertrain::Sensors(const mjModel* m, mjData* d, int instance) const {
  const State* s = reinterpret_cast<const State*>(d->plugin_state + m->plugin_stateadr[instance]);
  const mjtNum* output = reinterpret_cast<const mjtNum*>(&s->output);
  for (const auto& [address, place] : sensors_) d->sensordata[address] = output[place];
}

}  // namespace iits
