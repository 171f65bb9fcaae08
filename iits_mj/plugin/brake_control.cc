#include "plugin/brake_control.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "plugin/config.h"

namespace iits {
namespace {

// Judgement: figures of the deceleration control, which no source gives.
constexpr double kFilterTime = 0.3;    // of the measured deceleration [s]
constexpr double kTrimGain = 0.6;      // [1/s]
constexpr double kTrimMax = 0.4;       // [m/s2], plus
constexpr double kTrimShare = 0.3;     // of the demand
constexpr double kTrimSpeedMin = 2.0;  // [m/s]
constexpr double kSettled = 5e3;       // supply is this close to its set point [Pa]
constexpr double kHoldSpeed = 0.3;     // below, the vehicle stands [m/s]
constexpr double kHoldDemand = 1.6;    // deceleration whose pressure holds on a 15 % grade [m/s2]
constexpr double kReleaseSpeed = 1.0;  // above, holding is over [m/s]

}  // namespace

bool BrakeControl::Read(const mjModel* m, int instance) {
  const struct {
    const char* name;
    double low, high;
    double* value;
  } attributes[] = {
      {"supply_rise_rate", 1, 1e9, &rise_rate_},
      {"supply_fall_rate", 1, 1e9, &fall_rate_},
      {"pressure_max", 1, 1e8, &pressure_max_},
      {"hill_hold_time", 0, 60, &hill_hold_time_},
  };
  for (const auto& a : attributes) {
    *a.value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, a.value)) return false;
  }
  const char* const names[kCircuits] = {"pressure_front", "pressure_drive", "pressure_trailer"};
  for (int i = 0; i < kCircuits; ++i) {
    if (!ReadCurve(m, instance, "demand", names[i], 0, 1e8, &pressure_[i])) return false;
  }
  return true;
}

// A vehicle braked to a standstill is held while the demand lasts; on an upgrade also afterwards,
// until the driveline carries it or the hill-hold time is over.
void BrakeControl::Hold(const BrakeDemand& demand, double h, BrakeControlState* s) const {
  if (demand.active) {
    if (std::abs(demand.speed) < kHoldSpeed) s->holding = 1;
    s->hold_time = 0;
  } else if (s->holding != 0) {
    s->hold_time += h;
    bool carried = demand.uphill_torque < uphill_torque_min_;
    if (carried || s->hold_time > hill_hold_time_) s->holding = 0;
  }
  if (std::abs(demand.speed) > kReleaseSpeed) s->holding = 0;
}

// Integral of the deceleration's error against a reference that is as slow as the brakes. It stops
// when the error says nothing about the brakes: standing, ABS at work, supply still on its way.
void BrakeControl::Trim(const BrakeDemand& demand, double deceleration, double supplied, double h,
                        BrakeControlState* s) const {
  double wanted = demand.active ? demand.deceleration : 0;
  s->reference[0] += (supplied * wanted - s->reference[0]) * h / (response_time_ + h);
  s->reference[1] += (s->reference[0] - s->reference[1]) * h / (kFilterTime + h);
  if (!demand.active) {
    s->trim = 0;
    return;
  }
  if (demand.speed < kTrimSpeedMin || demand.abs_active || supplied < kSettled) return;
  double limit = kTrimMax + kTrimShare * wanted;
  s->trim += h * kTrimGain * (s->reference[1] - deceleration);
  s->trim = std::clamp(s->trim, -std::min(limit, wanted), limit);
}

void BrakeControl::Update(const BrakeDemand& demand, double h, BrakeControlState* s) const {
  if (s->initialized == 0) {
    s->initialized = 1;
    s->speed = demand.speed;
  }
  double difference = demand.speed - s->speed;
  s->speed += difference * h / (kFilterTime + h);
  double deceleration = -difference / (kFilterTime + h);
  Hold(demand, h, s);

  double wanted = 0;
  if (demand.active) wanted = std::max(0.0, demand.deceleration + s->trim);
  if (s->holding != 0) wanted = std::max(wanted, kHoldDemand);
  double supplied = 1;  // least share of a circuit's set point that its supply has reached
  for (int i = 0; i < kCircuits; ++i) {
    double target = wanted > 0 ? std::min(pressure_[i](wanted), pressure_max_) : 0;
    s->supply[i] = std::clamp(target, s->supply[i] - h * fall_rate_, s->supply[i] + h * rise_rate_);
    if (target > 0) supplied = std::min(supplied, s->supply[i] / target);
  }
  Trim(demand, deceleration, supplied, h, s);
}

}  // namespace iits
