#include "plugin/engine.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "plugin/config.h"

namespace iits {
namespace {

// Resolution of the engine brake's power law; its error is below 1e-5 of the torque.
constexpr int kBrakeIntervals = 256;

double Clip(double x, double low, double high) { return x < low ? low : (x > high ? high : x); }

}  // namespace

bool Engine::Read(const mjModel* m, int instance) {
  const Attribute attributes[] = {
      {"idle_speed", 20, 200, &idle_speed_},
      {"governed_speed", 50, 1000, &governed_speed_},
      {"governor_droop", 0.001, 0.5, &governor_droop_},
      {"reference_torque", 1, 1e5, &reference_torque_},
      {"engine_inertia", 0.01, 1000, &inertia_},
      {"pedal_up", 0, 0.5, &pedal_up_},
      {"pedal_fade", 0.001, 1, &pedal_fade_},
      {"torque_rise_rate", 1, 1e6, &rise_rate_},
      {"torque_rise_rate_low", 1, 1e6, &rise_rate_low_},
      {"torque_rise_threshold", 0, 1e5, &rise_threshold_},
      {"torque_fall_rate", 1, 1e6, &fall_rate_},
      {"torque_fall_rate_low", 1, 1e6, &fall_rate_low_},
      {"torque_fall_threshold", 0, 1e5, &fall_threshold_},
      {"torque_cut_time", 0.001, 10, &cut_time_},
      {"boost_lag", 0.001, 10, &boost_lag_},
      {"spool_time", 0.01, 100, &spool_time_},
      {"idle_gain", 0, 1e4, &idle_gain_},
      {"idle_integral_gain", 0, 1e4, &idle_integral_gain_},
      {"idle_band", 0, 1000, &idle_band_},
      {"idle_integral_min", -1e5, 0, &idle_integral_min_},
      {"idle_integral_max", 0, 1e5, &idle_integral_max_},
      {"idle_forget_time", 0.001, 100, &idle_forget_time_},
      {"synchronization_lag", 0.001, 10, &sync_lag_},
      {"synchronization_torque_share", 0, 1, &sync_torque_share_},
      {"synchronization_brake_share", 0, 1, &sync_brake_share_},
      {"engine_brake_power", 0, 1e7, &brake_power_},
      {"engine_brake_speed", 50, 1000, &brake_speed_},
      {"engine_brake_exponent", 0, 4, &brake_exponent_},
      {"engine_brake_speed_min", 0, 1000, &brake_speed_min_},
      {"engine_brake_fade", 0.1, 1000, &brake_fade_},
      {"engine_brake_lag", 0.001, 10, &brake_lag_},
      {"engine_brake_release_lag", 0.001, 10, &brake_release_lag_},
      {"idle_fuel_rate", 0, 1, &idle_fuel_rate_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  if (governed_speed_ <= 1.2 * idle_speed_) {
    mju_warning("plugin instance '%s': governed_speed %g must exceed 1.2 times idle_speed %g",
                InstanceName(m, instance).c_str(), governed_speed_, idle_speed_);
    return false;
  }
  // P = engine_brake_power (w / engine_brake_speed)^exponent through the rated point.
  auto law = [this](double speed) {
    return rated_brake_torque() * std::pow(speed / brake_speed_, brake_exponent_ - 1);
  };
  brake_torque_.Sample(law, 0.2 * brake_speed_, 1.2 * brake_speed_, kBrakeIntervals);
  return ReadCurve(m, instance, "full_load_speed", "full_load_torque", 0, 1e5, &full_load_) &&
         ReadCurve(m, instance, "drag_speed", "drag_torque", 0, 1e5, &drag_) &&
         ReadMap(m, instance, "pedal_map_speed", "pedal_map_pedal", "pedal_map_torque", 0, 1e5,
                 &pedal_map_) &&
         ReadMap(m, instance, "fuel_map_torque", "fuel_map_speed", "fuel_map_consumption", 0, 1,
                 &fuel_map_);
}

// Indicated torques: what the charge pressure lacks until it has risen from `boost` to `reached`,
// behind a demand that goes from `demand` toward `wanted` >= `reached`.
TorqueRecovery Engine::BoostRecovery(double demand, double boost, double wanted,
                                     double reached) const {
  if (reached <= demand) return {0, 0};
  // The demand rises in proportion to its gap, later at its constant rate.
  const double rest = wanted - reached, gap = wanted - demand, linear = rise_rate_ * spool_time_;
  const double last = std::max(linear, rest);
  double impulse = boost_lag_ * (reached - boost), time = boost_lag_;
  if (gap > last) {
    const double first = spool_time_ * std::log(gap / last);
    impulse += spool_time_ * (gap - last) - rest * first;
    time += first;
  }
  const double steady = std::max(0.0, std::min(gap, linear) - rest);
  impulse += 0.5 * steady * steady / rise_rate_;
  return {std::max(0.0, impulse), time + steady / rise_rate_};
}

TorqueRecovery Engine::Recovery(double before, double pause, double demand, double level,
                                double drag) const {
  if (level <= 0) return {0, 0};
  const double wanted = std::max(demand, level) + drag, reached = level + drag;
  const double start = std::max(before + drag, rise_threshold_);
  const double left = std::max(start - pause * fall_rate_low_, rise_threshold_);
  // The charge pressure lags behind the demand, falling as well as rising.
  const double fall = (start - left) / fall_rate_low_;
  const double excess = fall_rate_low_ * boost_lag_ * (1 - std::exp(-fall / boost_lag_)) *
                        std::exp(-(pause - fall) / boost_lag_);
  const double ramp = std::min(reached, left) / rise_rate_low_;
  const double quick = ramp * (reached - 0.5 * std::min(reached, left));
  const TorqueRecovery rest = BoostRecovery(left, left + excess, wanted, reached);
  return {quick + rest.impulse, ramp + rest.time};
}

TorqueRecovery Engine::BuildUp(double before, double demand, double level, double drag) const {
  const double wanted = std::max(demand, level) + drag;
  const double start = std::max(before + drag, rise_threshold_);
  return BoostRecovery(start, start, wanted, level + drag);
}

double Engine::Limit(double speed, double drag) const {
  double governor = Clip((governed_speed_ - speed) / (governor_droop_ * governed_speed_), 0, 1);
  return governor * (full_load_(speed) + drag) - drag;
}

EnginePoint Engine::At(double speed) const {
  double drag = drag_(speed);
  return {speed, drag, Limit(speed, drag), BrakeTorqueMax(speed)};
}

double Engine::PedalTorque(const EnginePoint& at, double pedal) const {
  if (pedal <= 0) return -at.drag;
  double wanted = std::min(pedal_map_(at.speed, pedal), at.limit);
  return std::min(1.0, pedal / pedal_fade_) * (wanted + at.drag) - at.drag;
}

// The power law, fading out near idle.
double Engine::BrakeTorqueMax(double speed) const {
  if (speed <= brake_speed_min_) return 0;
  return std::min(1.0, (speed - brake_speed_min_) / brake_fade_) * brake_torque_(speed);
}

// PI idle governor about the friction torque; indicated torque.
double Engine::IdleTorque(const EnginePoint& at, double h, EngineState* s) const {
  double error = idle_speed_ - at.speed;
  if (std::abs(error) < idle_band_) {
    s->idle_integral += h * idle_integral_gain_ * error;
  } else {
    s->idle_integral -= s->idle_integral * h / (idle_forget_time_ + h);
  }
  s->idle_integral = Clip(s->idle_integral, idle_integral_min_, idle_integral_max_);
  return std::max(0.0, at.drag + idle_gain_ * error + s->idle_integral);
}

// The free engine is brought to the new gear's speed, slowed by the engine brake where it must be.
void Engine::Synchronize(const EngineRequest& request, const EnginePoint& at, double h,
                         EngineState* s) const {
  double wanted = request.inertia * (request.target_speed - at.speed) / (sync_lag_ + h);
  double indicated = wanted + at.drag;
  s->torque = Clip(indicated, 0, sync_torque_share_ * reference_torque_);
  s->brake_torque = Clip(-indicated, 0, sync_brake_share_ * at.brake_max);
  s->idle_integral = 0;
}

// Torque that the air allows: the demand, rate-limited, through the turbocharger's lag. What a
// naturally aspirated engine can burn is there at once.
void Engine::UpdateBoost(double demand, double h, EngineState* s) const {
  const double floor = rise_threshold_;
  s->boost_demand = std::max(s->boost_demand, floor);
  double gap = demand - s->boost_demand;
  double rise = h * std::max(rise_rate_, gap / spool_time_);
  s->boost_demand += Clip(gap, -h * fall_rate_low_, rise);
  s->boost_demand = std::max(s->boost_demand, floor);
  s->boost += (s->boost_demand - s->boost) * h / (boost_lag_ + h);
  s->boost = std::max(s->boost, floor);
}

void Engine::UpdateBrake(const EngineRequest& request, double available, double h,
                         EngineState* s) const {
  if (request.engine_brake <= 0 && s->brake_torque <= 0) return;
  bool braking = request.mode == EngineRequest::kPedal && request.pedal < pedal_up_;
  double brake = braking ? request.engine_brake * available : 0;
  double lag = braking ? brake_lag_ : brake_release_lag_;
  s->brake_torque += (brake - s->brake_torque) * h / (lag + h);
  s->brake_torque = std::min(s->brake_torque, available);
}

void Engine::Update(const EngineRequest& request, const EnginePoint& at, double h,
                    EngineState* s) const {
  // Unloaded, in a gear change, the turbocharger loses its charge.
  if (request.mode != EngineRequest::kPedal) UpdateBoost(0, h, s);
  if (request.mode == EngineRequest::kSpeed) return Synchronize(request, at, h, s);
  UpdateBrake(request, at.brake_max, h, s);
  if (request.mode == EngineRequest::kCut) {
    s->torque -= s->torque * std::min(1.0, h / std::max(request.time_left, h));
    return;
  }
  double limit = at.limit + at.drag;
  double wanted = request.torque + at.drag;
  double demand = std::min(limit, std::max(wanted, IdleTorque(at, h, s)));
  UpdateBoost(demand, h, s);
  double target = std::min(demand, s->boost);
  if (target > s->torque) {
    s->torque = std::min(target, s->torque + h * rise_rate_low_);
  } else {
    double rate = s->torque > fall_threshold_ ? fall_rate_ : fall_rate_low_;
    if (request.limited) rate = std::max(rate, reference_torque_ / cut_time_);
    s->torque = std::max(target, s->torque - h * rate);
  }
  s->torque = std::min(s->torque, limit);
}

// Inside the map by specific consumption; below its lowest torque by a line through the idle rate
// (Willans), which ends at zero where combustion just stops (overrun).
double Engine::FuelRate(const EnginePoint& at, const EngineState& s) const {
  if (s.torque <= 0) return 0;
  double torque = s.torque - at.drag;
  double lowest = fuel_map_.rows.front();
  if (torque >= lowest) return fuel_map_(torque, at.speed) * torque * at.speed;
  double no_load = idle_fuel_rate_ * at.speed / idle_speed_;
  if (torque < 0) return no_load * s.torque / at.drag;
  double at_lowest = fuel_map_(lowest, at.speed) * lowest * at.speed;
  return no_load + (at_lowest - no_load) * torque / lowest;
}

}  // namespace iits
