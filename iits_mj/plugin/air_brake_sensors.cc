// Sensors of the air brake: which numbers of its state they show.
#include <mujoco/mujoco.h>

#include <cstddef>
#include <string>
#include <vector>

#include "plugin/air_brake.h"
#include "plugin/config.h"
#include "plugin/registration.h"

namespace iits {
namespace {

using State = AirBrake::State;

const char* const kCircuitNames[kCircuits] = {"front", "rear", "trailer"};
const char* const kPressures = "brake_pressures";
const char* const kTorques = "brake_torques";
const char* const kSpeeds = "wheel_speeds";
const char* const kSides[2] = {"_left", "_right"};

int Place(size_t offset) { return static_cast<int>(offset / sizeof(mjtNum)); }

// Place of a chamber's pressure in the state.
int Pressure(size_t wheel) {
  return Place(offsetof(State, now) + offsetof(AirBrake::Pneumatics, wheel) +
               wheel * sizeof(WheelBrakeState) + offsetof(WheelBrakeState, pressure));
}

int ReservoirPressure(size_t circuit) {
  return Place(offsetof(State, now) + offsetof(AirBrake::Pneumatics, reservoir) +
               offsetof(ReservoirState, pressure) + circuit * sizeof(mjtNum));
}

// Of the step that is being taken, as the other forces that sensors show.
int Torque(size_t wheel) {
  return Place(offsetof(State, next_wind_up) + offsetof(AirBrake::WindUp, torque) +
               wheel * sizeof(mjtNum));
}

struct Single {
  const char* name;
  size_t offset;
};
const Single kSingles[] = {
    {"xbr_active", offsetof(State, xbr_active)},
    {"abs_active", offsetof(State, abs_active)},
    {"brake_work", offsetof(State, work)},
    {"endurance_torque_demand", offsetof(State, endurance)},
    {"compressor_active", offsetof(State, now) + offsetof(AirBrake::Pneumatics, reservoir) +
                              offsetof(ReservoirState, pumping)},
};
static_assert(offsetof(EnduranceDemand, shaft_torque) == 0, "endurance_torque_demand shows it");

}  // namespace

// Appends places by the sensor's local name; false when there is no signal of that name.
bool AirBrake::FindSignal(const std::string& name, std::vector<int>* places) const {
  for (const Single& single : kSingles) {
    if (name != single.name) continue;
    places->push_back(Place(single.offset));
    return true;
  }
  for (int i = 0; i < kCircuits; ++i) {
    if (name != std::string("reservoir_pressure_") + kCircuitNames[i]) continue;
    places->push_back(ReservoirPressure(i));
    return true;
  }
  const std::string stem = "brake_pressure_";
  for (size_t i = wheels_.size(); i-- > 0;) {
    std::string axle = "axle" + std::to_string(i / 2 + 1) + kSides[i % 2];
    // The first axle of a circuit stands for it; counting down, it is the last to match.
    std::string circuit = stem + kCircuitNames[wheels_[i].circuit] + kSides[i % 2];
    bool first = true;
    for (size_t k = 0; k + 1 < i; ++k) first = first && wheels_[k].circuit != wheels_[i].circuit;
    if (name == stem + axle || (name == circuit && first)) {
      places->push_back(Pressure(i));
      return true;
    }
  }
  if (name != stem + "trailer") return false;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    if (wheels_[i].circuit == kTrailer) places->push_back(Pressure(i));
  }
  return true;
}

// One number, or one of every wheel: each sensor costs MuJoCo time, whatever it shows.
int AirBrake::SensorSize(const mjModel* m, int instance, int sensor) {
  std::string name = LocalName(mj_id2name(m, mjOBJ_SENSOR, sensor));
  bool every = name == kPressures || name == kTorques || name == kSpeeds;
  return every ? static_cast<int>(BodiesOfInstance(m, instance).size()) : 1;
}

bool AirBrake::FindSensors(const mjModel* m, int instance) {
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] != instance) continue;
    std::string name = LocalName(mj_id2name(m, mjOBJ_SENSOR, i));
    if (name == kPressures || name == kTorques) {
      for (int k = 0; k < static_cast<int>(wheels_.size()); ++k) {
        const int begin = static_cast<int>(places_.size());
        places_.push_back(name == kPressures ? Pressure(k) : Torque(k));
        sensors_.push_back({m->sensor_adr[i] + k, begin, begin + 1, 1});
      }
      continue;
    }
    if (name == kSpeeds) {
      speeds_ = m->sensor_adr[i];
      continue;
    }
    const size_t begin = places_.size();
    if (!FindSignal(name, &places_)) {
      std::string known;
      for (const Single& single : kSingles) known += std::string(single.name) + ", ";
      mju_warning(
          "plugin instance '%s': sensor '%s' is unknown; known are %s"
          "reservoir_pressure_{front,rear,trailer}, "
          "brake_pressure_{front,rear}_{left,right}, brake_pressure_trailer, "
          "brake_pressure_axle{1..%zu}_{left,right}, %s, %s, %s",
          InstanceName(m, instance).c_str(), name.c_str(), known.c_str(), wheels_.size() / 2,
          kPressures, kTorques, kSpeeds);
      return false;
    }
    const size_t count = places_.size() - begin;
    sensors_.push_back({m->sensor_adr[i], static_cast<int>(begin), static_cast<int>(places_.size()),
                        count ? 1. / count : 0});
  }
  return true;
}

void AirBrake::Sensors(const mjModel* m, mjData* d, int instance) const {
  const mjtNum* state = d->plugin_state + m->plugin_stateadr[instance];
  for (const Sensor& sensor : sensors_) {
    double sum = 0;
    for (int i = sensor.begin; i < sensor.end; ++i) sum += state[places_[i]];
    d->sensordata[sensor.address] = sum * sensor.share;
  }
  if (speeds_ < 0) return;
  for (size_t i = 0; i < wheels_.size(); ++i) d->sensordata[speeds_ + i] = d->qvel[wheels_[i].dof];
}

}  // namespace iits
