#include "plugin/gearbox.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "plugin/config.h"
#include "plugin/engine.h"

namespace iits {
namespace {

// Judgement, all of it: the release's tables say when to shift, not when not to.
constexpr double kAccelerationLag = 0.25;    // of the shaft's acceleration [s]
constexpr double kLoadLag = 0.4;             // of the load estimate [s]
constexpr double kLowSpeedIdle = 1.15;       // lowest engine speed in gear, of idle, pedal up
constexpr double kLowSpeedPedal = 0.6;       // ... more of it with the pedal down
constexpr double kUpshiftMargin = 1.05;      // of the lowest speed, after an upshift
constexpr double kDownshiftMargin = 1.2;     // of the lowest speed, after a downshift
constexpr double kTorqueReserve = 1.03;      // of the load, after an upshift
constexpr double kOverspeed = 1.08;          // of the governed speed: driven beyond, shift up
constexpr double kDownshiftSpeedMax = 0.85;  // of the governed speed, after a downshift
constexpr double kPowerSpeed = 2.0;   // of idle: below, a floored pedal asks for a lower gear
constexpr double kFullTorque = 0.85;  // of the pedal's torque: it has built up
constexpr double kStuck = 0.15;  // acceleration below which a low engine speed is no start [m/s2]
constexpr double kFirstGearDelay = 1.5;    // more than the downshift's, before first gear [s]
constexpr double kSynchronized = 6.0;      // speed difference at which the gear goes in [rad/s]
constexpr double kSynchronizeLimit = 2.5;  // of the synchronization time, then it goes in anyway
constexpr double kEngageSpeedMax = 1.0;    // against the direction of travel [m/s]
constexpr double kPedalUp = 0.02;
constexpr double kFloored = 0.7;
constexpr int kSkipUpMax = 2;

}  // namespace

bool Gearbox::Read(const mjModel* m, int instance, double mass) {
  double wheel_radius;
  const struct {
    const char* name;
    double low, high;
    double* value;
  } attributes[] = {
      {"final_drive", 0.1, 20, &final_drive_},
      {"efficiency", 0.5, 1, &efficiency_},
      {"reverse_ratio", 0.1, 100, &reverse_ratio_},
      {"start_gear", 1, 32, &start_gear_},
      {"shift_cut_time", 0.001, 5, &cut_time_},
      {"synchronization_time", 0.001, 5, &synchronization_time_},
      {"clutch_close_time", 0.001, 5, &close_time_},
      {"downshift_delay", 0, 10, &downshift_delay_},
      {"downshift_margin", 0, 20, &downshift_margin_},
      {"min_gear_time", 0, 20, &min_gear_time_},
      {"wheel_radius", 0.05, 5, &wheel_radius},
  };
  for (const auto& a : attributes) {
    *a.value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, a.value)) return false;
  }
  meters_per_radian_ = wheel_radius / final_drive_;
  vehicle_inertia_ = mass * meters_per_radian_ * meters_per_radian_;
  if (!ReadNumbers(m, instance, "ratios", 2, 32, 0.05, 200, &ratios_)) return false;
  const size_t n = ratios_.size();
  for (size_t i = 1; i < n; ++i) {
    if (ratios_[i] >= ratios_[i - 1]) {
      mju_warning("plugin instance '%s': attribute 'ratios' must fall, but %g follows %g",
                  InstanceName(m, instance).c_str(), ratios_[i], ratios_[i - 1]);
      return false;
    }
  }
  start_gear_ = std::floor(start_gear_);
  if (start_gear_ > n) {
    mju_warning("plugin instance '%s': start_gear %g is beyond the %zu gears",
                InstanceName(m, instance).c_str(), start_gear_, n);
    return false;
  }
  return ReadNumbers(m, instance, "gear_inertias", n, n, 0, 100, &inertias_) &&
         ReadMap(m, instance, "upshift_gear", "upshift_pedal", "upshift_speed", 0, 200,
                 &upshift_) &&
         ReadMap(m, instance, "downshift_gear", "downshift_pedal", "downshift_speed", 0, 200,
                 &downshift_);
}

double Gearbox::Ratio(int gear) const {
  if (gear > 0) return ratios_[gear - 1];
  return gear < 0 ? -reverse_ratio_ : 0;
}

double Gearbox::InputInertia(int gear) const { return gear ? inertias_[std::abs(gear) - 1] : 0; }

// Lowest engine speed that the controller accepts in gear; higher with the pedal down.
double Gearbox::LowSpeed(const Engine& engine, double pedal) const {
  return engine.idle_speed() * (kLowSpeedIdle + kLowSpeedPedal * pedal);
}

double Gearbox::SpeedAfterChange(const GearboxState& s, bool powered) const {
  double time = cut_time_ + synchronization_time_ + close_time_;
  double coasting = -s.load / vehicle_inertia_;
  return s.shaft_speed + time * (powered ? std::min(coasting, s.acceleration) : s.acceleration);
}

int Gearbox::GearForSpeed(const Engine& engine, double shaft_speed) const {
  for (int gear = count(); gear > start_gear_; --gear) {
    if (ratios_[gear - 1] * shaft_speed >= 1.7 * engine.idle_speed()) return gear;
  }
  return static_cast<int>(start_gear_);
}

// Shaft speed is low-passed once; its distance to the raw speed is the filtered acceleration.
// Load: torque that would hold the speed, by the balance T = load + I dw/dt of the vehicle's mass.
void Gearbox::Filter(const GearboxInput& in, double h, GearboxState* s) const {
  double difference = in.shaft_speed - s->shaft_speed;
  s->shaft_speed += difference * h / (kAccelerationLag + h);
  s->acceleration = difference / (kAccelerationLag + h);
  double load = in.shaft_torque - vehicle_inertia_ * s->acceleration;
  s->load += (load - s->load) * h / (kLoadLag + h);
}

// Highest gear within two steps that table, engine speed and torque reserve allow. The speed is
// that which is left when the new gear's torque has built up to the load.
int Gearbox::Upshift(const Engine& engine, const GearboxInput& in, const GearboxState& s,
                     int gear) const {
  double ceiling = kOverspeed * engine.governed_speed();
  if (in.engine_brake > 0) ceiling = std::max(ceiling, engine.brake_speed());
  if (ratios_[gear - 1] * in.shaft_speed > ceiling) return gear + 1;
  if (in.pedal < kPedalUp) return gear;
  int best = gear;
  double after = SpeedAfterChange(s, true);
  double coasting = std::max(0.0, s.load) / vehicle_inertia_;
  for (int next = gear + 1; next <= std::min(count(), gear + kSkipUpMax); ++next) {
    if (Speed(in.shaft_speed) < upshift_(next - 1, in.pedal)) break;
    double reduction = ratios_[next - 1] * efficiency_;
    double recovery = 0.5 * engine.RecoveryTime(s.load / reduction);
    double speed = ratios_[next - 1] * (after - coasting * recovery);
    if (speed < kUpshiftMargin * LowSpeed(engine, in.pedal)) break;
    if (engine.PedalTorque(speed, in.pedal) * reduction >= kTorqueReserve * s.load) best = next;
  }
  return best;
}

bool Gearbox::CallsForLower(const Engine& engine, const GearboxInput& in,
                            const GearboxState& s) const {
  int gear = static_cast<int>(s.gear);
  if (gear < 2) return false;
  double input_speed = ratios_[gear - 1] * in.shaft_speed;
  double acceleration = s.acceleration * meters_per_radian_;
  if (gear <= start_gear_) {
    return in.pedal > kFloored && acceleration < kStuck && input_speed < LowSpeed(engine, in.pedal);
  }
  if (input_speed < 1.05 * engine.idle_speed()) return true;
  if (input_speed < LowSpeed(engine, in.pedal) && acceleration < kStuck) return true;
  if (Speed(in.shaft_speed) < downshift_(gear, in.pedal) - downshift_margin_) return true;
  // Floored pedal, the engine gives what it has, and still speed is lost.
  double full = engine.PedalTorque(input_speed, in.pedal) * ratios_[gear - 1] * efficiency_;
  return in.pedal > kFloored && in.shaft_torque > kFullTorque * full &&
         input_speed < kPowerSpeed * engine.idle_speed() && acceleration < -0.03;
}

// Lower gear whose engine speed will be comfortable when the change is over.
int Gearbox::Downshift(const Engine& engine, const GearboxInput& in, const GearboxState& s,
                       int gear) const {
  double ceiling = kDownshiftSpeedMax * engine.governed_speed();
  double after = SpeedAfterChange(s, in.pedal > kPedalUp);
  double wanted = kDownshiftMargin * LowSpeed(engine, in.pedal);
  int lowest = in.pedal > kFloored ? 1 : static_cast<int>(start_gear_);
  int next = gear;
  while (next > lowest && (next == gear || ratios_[next - 1] * after < wanted) &&
         ratios_[next - 2] * in.shaft_speed < ceiling) {
    --next;
  }
  return next;
}

int Gearbox::Choose(const Engine& engine, const GearboxInput& in, const GearboxState& s) const {
  double speed = Speed(in.shaft_speed);
  int gear = static_cast<int>(s.gear);
  if (in.mode == GearboxInput::kNeutral) return 0;
  if (in.mode == GearboxInput::kReverse) {
    return gear == -1 || std::abs(speed) < kEngageSpeedMax ? -1 : 0;
  }
  if (gear <= 0) {
    return speed > -kEngageSpeedMax ? GearForSpeed(engine, in.shaft_speed) : 0;
  }
  int start = static_cast<int>(start_gear_);
  bool standing = ratios_[start - 1] * in.shaft_speed < engine.idle_speed();
  if (standing && in.clutch_open && gear > start) return start;
  bool overspeed = ratios_[gear - 1] * in.shaft_speed > 1.05 * engine.brake_speed();
  if (s.gear_time < min_gear_time_ && !overspeed) return gear;
  if (gear < count()) {
    int higher = Upshift(engine, in, s, gear);
    if (higher != gear) return higher;
  }
  double delay = downshift_delay_ + (gear <= start ? kFirstGearDelay : 0);
  return s.low_time > delay ? Downshift(engine, in, s, gear) : gear;
}

void Gearbox::Update(const Engine& engine, const GearboxInput& in, double h,
                     GearboxState* s) const {
  Filter(in, h, s);
  s->phase_time += h;
  switch (static_cast<int>(s->phase)) {
    case kInGear: {
      s->gear_time += h;
      s->low_time = CallsForLower(engine, in, *s) ? s->low_time + h : 0;
      s->target = Choose(engine, in, *s);
      if (s->target == s->gear) return;
      s->phase = s->gear == 0 || in.clutch_open ? kSynchronize : kCut;
      s->phase_time = s->low_time = 0;
      if (s->phase == kSynchronize) s->gear = 0;
      return;
    }
    case kCut:
      if (s->phase_time < cut_time_) return;
      s->gear = 0;
      s->phase = kSynchronize;
      s->phase_time = 0;
      return;
    case kSynchronize: {
      bool drive = in.mode == GearboxInput::kDrive;
      bool wrong = in.mode == GearboxInput::kNeutral || (s->target > 0) != drive;
      if (s->target == 0 || wrong) {
        s->target = s->phase = s->phase_time = s->gear_time = 0;
        return;
      }
      double speed = Ratio(static_cast<int>(s->target)) * in.shaft_speed;
      double off = std::abs(in.engine_speed - std::max(speed, engine.idle_speed()));
      if (s->phase_time < synchronization_time_) return;
      if (off > kSynchronized && s->phase_time < kSynchronizeLimit * synchronization_time_) return;
      s->gear = s->target;
      s->phase_time = s->gear_time = 0;
      // At a standstill the gear goes in with the clutch open: nothing to close.
      s->phase = speed > engine.idle_speed() ? kClose : kInGear;
      return;
    }
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
