// Sensors of the air brake: which numbers of its state they show.
#include <mujoco/mujoco.h>

#include <cstddef>
#include <string>
#include <vector>

#include "plugin/air_brake.h"
#include "plugin/config.h"

namespace iits {
namespace {

using State = AirBrake::State;

constexpr int kXbrActive = offsetof(State, xbr_active) / sizeof(mjtNum);
constexpr int kAbsActive = offsetof(State, abs_active) / sizeof(mjtNum);

// Place of a chamber's pressure in the state.
int Pressure(size_t wheel) {
  size_t offset = offsetof(State, now) + offsetof(AirBrake::Pneumatics, wheel) +
                  wheel * sizeof(WheelBrakeState) + offsetof(WheelBrakeState, pressure);
  return static_cast<int>(offset / sizeof(mjtNum));
}

}  // namespace

// Appends places by the sensor's local name; false when there is no signal of that name.
bool AirBrake::FindSignal(const std::string& name, std::vector<int>* places) const {
  if (name == "xbr_active" || name == "abs_active") {
    places->push_back(name == "xbr_active" ? kXbrActive : kAbsActive);
    return true;
  }
  const char* const circuits[kCircuits] = {"front", "rear", "trailer"};
  const char* const sides[2] = {"_left", "_right"};
  const std::string stem = "brake_pressure_";
  for (size_t i = wheels_.size(); i-- > 0;) {
    std::string axle = stem + "axle" + std::to_string(i / 2 + 1) + sides[i % 2];
    // The first axle of a circuit stands for it; counting down, it is the last to match.
    std::string circuit = stem + circuits[wheels_[i].circuit] + sides[i % 2];
    bool first = true;
    for (size_t k = 0; k + 1 < i; ++k) first = first && wheels_[k].circuit != wheels_[i].circuit;
    if (name == axle || (name == circuit && first)) {
      places->push_back(Pressure(i));
      return true;
    }
  }
  if (name != stem + "trailer") return false;
  for (size_t i = 0; i < wheels_.size(); ++i) {
    if (wheels_[i].circuit == kCircuits - 1) places->push_back(Pressure(i));
  }
  return true;
}

bool AirBrake::FindSensors(const mjModel* m, int instance) {
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] != instance) continue;
    std::string name = LocalName(mj_id2name(m, mjOBJ_SENSOR, i));
    const size_t begin = places_.size();
    if (!FindSignal(name, &places_)) {
      mju_warning(
          "plugin instance '%s': sensor '%s' is unknown; known are xbr_active, abs_active, "
          "brake_pressure_{front,rear}_{left,right}, brake_pressure_trailer, "
          "brake_pressure_axle{1..%zu}_{left,right}",
          InstanceName(m, instance).c_str(), name.c_str(), wheels_.size() / 2);
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
}

}  // namespace iits
