#include "plugin/engine.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "plugin/config.h"

namespace iits {
namespace {

// Judgement, all of it: figures of a heavy-duty engine controller that no source gives.
constexpr double kGovernorDroop = 0.04;     // of the governed speed, over which torque goes to zero
constexpr double kPedalFade = 0.05;         // pedal travel over which overrun turns into traction
constexpr double kIdleGain = 20.0;          // [N m s/rad]
constexpr double kIdleIntegralGain = 30.0;  // [N m/rad]
constexpr double kIdleBand = 12.0;          // |speed error| within which the governor integrates
constexpr double kIdleIntegralMax = 400.0;  // [N m]
constexpr double kIdleForget = 0.2;         // time constant outside the band [s]
constexpr double kSpeedLag = 0.08;          // of the speed control while synchronizing [s]
constexpr double kSpeedTorqueMax = 0.3;     // of the reference torque, while synchronizing
constexpr double kSpeedBrakeShare = 0.4;    // of the engine brake, while synchronizing
constexpr double kSpoolTime = 3.0;          // a large step of demand rises faster than the rate [s]
constexpr double kBrakeLag = 0.25;          // of the engine brake's flaps [s]
constexpr double kBrakeExponent = 1.3986;   // power law with 55 % of the power at 1500 of 2300 rpm
constexpr double kBrakeSpeedMin = 85.0;     // no engine brake below [rad/s]; full 20 rad/s above

double Clip(double x, double low, double high) { return x < low ? low : (x > high ? high : x); }

}  // namespace

bool Engine::Read(const mjModel* m, int instance) {
  const struct {
    const char* name;
    double low, high;
    double* value;
  } attributes[] = {
      {"idle_speed", 20, 200, &idle_speed_},
      {"governed_speed", 50, 1000, &governed_speed_},
      {"reference_torque", 1, 1e5, &reference_torque_},
      {"engine_inertia", 0.01, 1000, &inertia_},
      {"torque_rise_rate", 1, 1e6, &rise_rate_},
      {"torque_rise_rate_low", 1, 1e6, &rise_rate_low_},
      {"torque_rise_threshold", 0, 1e5, &rise_threshold_},
      {"torque_fall_rate", 1, 1e6, &fall_rate_},
      {"torque_fall_rate_low", 1, 1e6, &fall_rate_low_},
      {"torque_fall_threshold", 0, 1e5, &fall_threshold_},
      {"boost_lag", 0.001, 10, &boost_lag_},
      {"engine_brake_power", 0, 1e7, &brake_power_},
      {"engine_brake_speed", 50, 1000, &brake_speed_},
      {"idle_fuel_rate", 0, 1, &idle_fuel_rate_},
  };
  for (const auto& a : attributes) {
    *a.value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, a.value)) return false;
  }
  if (governed_speed_ <= 1.2 * idle_speed_) {
    mju_warning("plugin instance '%s': governed_speed %g must exceed 1.2 times idle_speed %g",
                InstanceName(m, instance).c_str(), governed_speed_, idle_speed_);
    return false;
  }
  return ReadCurve(m, instance, "full_load_speed", "full_load_torque", 0, 1e5, &full_load_) &&
         ReadCurve(m, instance, "drag_speed", "drag_torque", 0, 1e5, &drag_) &&
         ReadMap(m, instance, "pedal_map_speed", "pedal_map_pedal", "pedal_map_torque", 0, 1e5,
                 &pedal_map_) &&
         ReadMap(m, instance, "fuel_map_torque", "fuel_map_speed", "fuel_map_consumption", 0, 1,
                 &fuel_map_);
}

double Engine::RecoveryImpulse(double before, double pause, double demand, double level,
                               double drag) const {
  if (level <= 0) return 0;
  // Indicated torques from here on.
  const double wanted = std::max(demand, level) + drag, reached = level + drag;
  const double left = std::max(before + drag - pause * fall_rate_low_, rise_threshold_);
  const double ramp = std::min(reached, left) / rise_rate_low_;
  const double quick = ramp * (reached - 0.5 * std::min(reached, left));
  if (reached <= left) return quick;
  // The demand rises in proportion to its gap, later at its constant rate.
  const double gap = wanted - left, last = std::max(rise_rate_ * kSpoolTime, wanted - reached);
  double time = gap > last ? kSpoolTime * std::log(gap / last) : 0;
  time += std::max(0.0, std::min(gap, last) - (wanted - reached)) / rise_rate_;
  return quick + (reached - left) * (0.5 * time + boost_lag_);
}

double Engine::Governor(double speed) const {
  return Clip((governed_speed_ - speed) / (kGovernorDroop * governed_speed_), 0, 1);
}

double Engine::TorqueLimit(double speed) const {
  double drag = drag_(speed);
  return Governor(speed) * (full_load_(speed) + drag) - drag;
}

double Engine::PedalTorque(double speed, double pedal) const {
  double drag = drag_(speed);
  double wanted = std::min(pedal_map_(speed, pedal), TorqueLimit(speed));
  return std::min(1.0, pedal / kPedalFade) * (wanted + drag) - drag;
}

double Engine::BrakeTorque(const EngineState& s) const {
  return s.torque - drag_(s.speed) - s.brake_torque;
}

// Engine brake: power law through the rated point, fading out near idle.
double Engine::BrakeTorqueMax(double speed) const {
  if (speed <= kBrakeSpeedMin) return 0;
  double rated = brake_power_ / brake_speed_;
  double fade = std::min(1.0, (speed - kBrakeSpeedMin) / 20.0);
  return fade * rated * std::pow(speed / brake_speed_, kBrakeExponent - 1);
}

// PI idle governor about the friction torque; indicated torque.
double Engine::IdleTorque(double h, EngineState* s) const {
  double error = idle_speed_ - s->speed;
  if (std::abs(error) < kIdleBand) {
    s->idle_integral += h * kIdleIntegralGain * error;
  } else {
    s->idle_integral -= s->idle_integral * h / (kIdleForget + h);
  }
  s->idle_integral = Clip(s->idle_integral, -0.25 * kIdleIntegralMax, kIdleIntegralMax);
  return std::max(0.0, drag_(s->speed) + kIdleGain * error + s->idle_integral);
}

// The free engine is brought to the new gear's speed, slowed by the engine brake where it must be.
void Engine::Synchronize(const EngineRequest& request, double h, EngineState* s) const {
  double wanted = request.inertia * (request.target_speed - s->speed) / (kSpeedLag + h);
  double indicated = wanted + drag_(s->speed);
  s->torque = Clip(indicated, 0, kSpeedTorqueMax * reference_torque_);
  s->brake_torque = Clip(-indicated, 0, kSpeedBrakeShare * BrakeTorqueMax(s->speed));
  s->idle_integral = 0;
}

// Torque that the air allows: the demand, rate-limited, through the turbocharger's lag. What a
// naturally aspirated engine can burn is there at once.
void Engine::UpdateBoost(double demand, double h, EngineState* s) const {
  const double floor = rise_threshold_;
  s->boost_demand = std::max(s->boost_demand, floor);
  double gap = demand - s->boost_demand;
  double rise = h * std::max(rise_rate_, gap / kSpoolTime);
  s->boost_demand += Clip(gap, -h * fall_rate_low_, rise);
  s->boost_demand = std::max(s->boost_demand, floor);
  s->boost += (s->boost_demand - s->boost) * h / (boost_lag_ + h);
  s->boost = std::max(s->boost, floor);
}

void Engine::Update(const EngineRequest& request, double h, EngineState* s) const {
  double drag = drag_(s->speed);
  // Unloaded, in a gear change, the turbocharger loses its charge.
  if (request.mode != EngineRequest::kPedal) UpdateBoost(0, h, s);
  if (request.mode == EngineRequest::kSpeed) return Synchronize(request, h, s);
  bool braking = request.mode == EngineRequest::kPedal && request.pedal < 0.02;
  if (request.engine_brake > 0 || s->brake_torque > 0) {  // seldom; spares the power law
    double available = BrakeTorqueMax(s->speed);
    double brake = braking ? request.engine_brake * available : 0;
    s->brake_torque += (brake - s->brake_torque) * h / ((braking ? kBrakeLag : 0.05) + h);
    s->brake_torque = std::min(s->brake_torque, available);
  }
  if (request.mode == EngineRequest::kCut) {
    s->torque -= s->torque * std::min(1.0, h / std::max(request.time_left, h));
    return;
  }
  double limit = TorqueLimit(s->speed) + drag;
  double wanted = PedalTorque(s->speed, request.pedal) + drag;
  double demand = std::min(limit, std::max(wanted, IdleTorque(h, s)));
  UpdateBoost(demand, h, s);
  double target = std::min(demand, s->boost);
  if (target > s->torque) {
    s->torque = std::min(target, s->torque + h * rise_rate_low_);
  } else {
    double rate = s->torque > fall_threshold_ ? fall_rate_ : fall_rate_low_;
    s->torque = std::max(target, s->torque - h * rate);
  }
  s->torque = std::min(s->torque, limit);
}

// Inside the map by specific consumption; below its lowest torque by a line through the idle rate
// (Willans), which ends at zero where combustion just stops (overrun).
double Engine::FuelRate(const EngineState& s) const {
  if (s.torque <= 0) return 0;
  double torque = s.torque - drag_(s.speed);
  double lowest = fuel_map_.rows.front();
  if (torque >= lowest) return fuel_map_(torque, s.speed) * torque * s.speed;
  double no_load = idle_fuel_rate_ * s.speed / idle_speed_;
  if (torque < 0) return no_load * s.torque / drag_(s.speed);
  double at_lowest = fuel_map_(lowest, s.speed) * lowest * s.speed;
  return no_load + (at_lowest - no_load) * torque / lowest;
}

}  // namespace iits
