#include "plugin/gearbox.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "plugin/config.h"

namespace iits {

bool Gearbox::Read(const mjModel* m, int instance) {
  const Attribute attributes[] = {
      {"shift_cut_time", 0.001, 5, &cut_time_},
      {"synchronization_time", 0.001, 5, &synchronization_time_},
      {"synchronization_time_max", 0.001, 5, &synchronization_limit_},
      {"synchronized_difference", 0.1, 100, &synchronized_difference_},
      {"clutch_close_time", 0.001, 5, &close_time_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  double change_time = cut_time_ + synchronization_time_ + close_time_;
  return ReadGears(m, instance) && strategy_.Read(m, instance, gears_.count(), change_time);
}

bool Gearbox::ReadGears(const mjModel* m, int instance) {
  double wheel_radius, driveline_efficiency;
  const Attribute attributes[] = {
      {"final_drive", 0.1, 20, &gears_.final_drive},
      {"efficiency", 0.5, 1, &gears_.gear_efficiency},
      {"driveline_efficiency", 0.5, 1, &driveline_efficiency},
      {"reverse_ratio", 0.1, 100, &gears_.reverse_ratio},
      {"wheel_radius", 0.05, 5, &wheel_radius},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  gears_.efficiency = gears_.gear_efficiency * driveline_efficiency;
  gears_.meters_per_radian = wheel_radius / gears_.final_drive;
  std::vector<double>& ratios = gears_.ratios;
  if (!ReadNumbers(m, instance, "ratios", 2, 32, 0.05, 200, &ratios)) return false;
  const size_t n = ratios.size();
  for (size_t i = 1; i < n; ++i) {
    if (ratios[i] >= ratios[i - 1]) {
      mju_warning("plugin instance '%s': attribute 'ratios' must fall, but %g follows %g",
                  InstanceName(m, instance).c_str(), ratios[i], ratios[i - 1]);
      return false;
    }
  }
  return ReadNumbers(m, instance, "gear_inertias", n, n, 0, 100, &gears_.inertias);
}

// Chooses a gear and begins the change when it is another one.
void Gearbox::Choose(const Engine& engine, const GearboxInput& in, double h,
                     GearboxState* s) const {
  const int gear = static_cast<int>(s->gear);
  const double speed = gears_.Speed(in.shaft_speed);
  const double slow = strategy_.engage_speed_max();
  ShiftStrategy::Choice choice = {gear, false};
  if (in.mode == GearboxInput::kNeutral) {
    choice.gear = 0;
  } else if (in.mode == GearboxInput::kReverse) {
    choice.gear = gear == -1 || std::abs(speed) < slow ? -1 : 0;
  } else if (gear <= 0) {
    choice.gear = speed > -slow ? GearForSpeed(engine, in.shaft_speed) : 0;
  } else {
    const ShiftStrategy::Situation now = {gears_, engine, in, *s, gear};
    s->low_time = strategy_.LowTime(now, h);
    choice = strategy_.Choose(now, h);
  }
  s->target = choice.gear;
  if (choice.gear == gear) return;
  s->direction = gear > 0 && choice.gear > 0 ? (choice.gear > gear ? 1 : -1) : 0;
  if (choice.failed) {
    s->failed_gear = gear;
    s->failed_load = s->load;
  }
  s->phase = gear == 0 || in.clutch_open ? kSynchronize : kCut;
  s->phase_time = s->low_time = 0;
  if (s->phase == kSynchronize) s->gear = 0;
}

// Waits in neutral until both sides turn alike, then puts the gear in. A gear that has come to fit
// the speed no more, because of hard braking say, is replaced.
void Gearbox::Synchronize(const Engine& engine, const GearboxInput& in, GearboxState* s) const {
  bool drive = in.mode == GearboxInput::kDrive;
  bool wrong = in.mode == GearboxInput::kNeutral || (s->target > 0) != drive;
  if (s->target == 0 || wrong) {
    s->target = s->phase = s->phase_time = s->gear_time = 0;
    return;
  }
  const double closed = in.shaft_speed + close_time_ * s->acceleration;
  if (drive && !strategy_.Fits(gears_, engine, static_cast<int>(s->target), closed)) {
    s->target = GearForSpeed(engine, closed);
  }
  if (s->phase_time < synchronization_time_) return;
  const double ratio = Ratio(static_cast<int>(s->target));
  const double speed = ratio * in.shaft_speed;
  double off = std::abs(in.engine_speed - std::max(speed, engine.idle_speed()));
  if (off > synchronized_difference_ && s->phase_time < synchronization_limit_) return;
  s->gear = s->target;
  s->phase_time = s->gear_time = 0;
  // Near a standstill the gear goes in with the clutch open, to be closed as in a start.
  const double slowest = strategy_.LowSpeed(engine, 0);
  s->phase = std::min(speed, ratio * closed) > slowest ? kClose : kInGear;
}

void Gearbox::Update(const Engine& engine, const GearboxInput& in, double h,
                     GearboxState* s) const {
  strategy_.Observe(gears_, in, h, s);
  s->phase_time += h;
  switch (static_cast<int>(s->phase)) {
    case kInGear:
      s->gear_time += h;
      Choose(engine, in, h, s);
      return;
    case kCut:
      if (s->phase_time < cut_time_) return;
      s->gear = 0;
      s->phase = kSynchronize;
      s->phase_time = 0;
      return;
    case kSynchronize:
      Synchronize(engine, in, s);
      return;
    case kClose:
      if (s->phase_time < close_time_) return;
      s->phase = kInGear;
      s->phase_time = s->gear_time = 0;
      return;
  }
}

EngineRequest Gearbox::Request(const Engine& engine, const GearboxInput& in,
                               const GearboxState& s) const {
  EngineRequest request = {EngineRequest::kPedal, in.pedal, in.engine_brake, 0, 0, 0};
  if (s.phase == kCut) {
    request.mode = EngineRequest::kCut;
    request.time_left = cut_time_ - s.phase_time;
  } else if (s.phase == kSynchronize || s.phase == kClose) {
    double speed = Ratio(static_cast<int>(s.target)) * in.shaft_speed;
    request.mode = EngineRequest::kSpeed;
    request.target_speed = std::clamp(speed, engine.idle_speed(), engine.brake_speed());
    request.inertia = engine.inertia() + InputInertia(static_cast<int>(s.target));
  }
  return request;
}

}  // namespace iits
