// Automated gearbox: the sequence of a gear change.
#ifndef IITS_MJ_PLUGIN_LAWS_GEARBOX_H_
#define IITS_MJ_PLUGIN_LAWS_GEARBOX_H_

#include "plugin/laws/engine.h"
#include "plugin/laws/gears.h"
#include "plugin/laws/shift_strategy.h"

namespace iits {

template <class T>
struct Gearbox {
  enum Phase { kInGear = 0, kCut, kSynchronize, kClose };

  Gears<T> gears;
  ShiftStrategy<T> strategy;
  // Attributes.
  T cut_time, synchronization_time, synchronization_limit, close_time, synchronized_difference;

  // Gear to engage at a speed in neutral.
  int GearForSpeed(const Engine<T>& engine, T shaft_speed) const {
    return strategy.GearForSpeed(gears, engine, shaft_speed);
  }

  // Advances filters, gear choice, and the sequence of a change by one step.
  void Update(const Engine<T>& engine, const GearboxInput<T>& in, T h, GearboxState<T>* s) const {
    strategy.Observe(gears, in, h, s);
    s->phase_time += h;
    switch (Whole(s->phase, kInGear, kClose)) {
      case kInGear:
        s->gear_time += h;
        Choose(engine, in, h, s);
        return;
      case kCut:
        if (s->phase_time < cut_time) return;
        s->gear = 0;
        s->phase = kSynchronize;
        s->phase_time = 0;
        return;
      case kSynchronize:
        Synchronize(engine, in, s);
        return;
      case kClose:
        if (s->phase_time < close_time) return;
        s->phase = kInGear;
        s->phase_time = s->gear_time = 0;
        return;
    }
  }

  // The gearbox's request to the engine; `kPedal` in gear.
  EngineRequest<T> Request(const Engine<T>& engine, const GearboxInput<T>& in,
                           const GearboxState<T>& s) const {
    EngineRequest<T> request = {EngineRequest<T>::kPedal, in.pedal, in.engine_brake, 0, 0, 0};
    if (s.phase == kCut) {
      request.mode = request.kCut;
      request.time_left = cut_time - s.phase_time;
    } else if (s.phase == kSynchronize || s.phase == kClose) {
      const int target = gears.Gear(s.target);
      const T speed = gears.Ratio(target) * in.shaft_speed;
      request.mode = request.kSpeed;
      request.target_speed = Clamp(speed, engine.idle_speed, engine.brake_speed);
      request.inertia = engine.inertia + gears.InputInertia(target);
    }
    return request;
  }

 private:
  // Chooses a gear and begins a change if it is not the present gear.
  void Choose(const Engine<T>& engine, const GearboxInput<T>& in, T h, GearboxState<T>* s) const {
    const int gear = gears.Gear(s->gear);
    const T speed = gears.Speed(in.shaft_speed);
    const T slow = strategy.engage_speed_max;
    typename ShiftStrategy<T>::Choice choice = {gear, false};
    if (in.mode == in.kNeutral) {
      choice.gear = 0;
    } else if (in.mode == in.kReverse) {
      choice.gear = gear == -1 || abs(speed) < slow ? -1 : 0;
    } else if (gear <= 0) {
      choice.gear = speed > -slow ? GearForSpeed(engine, in.shaft_speed) : 0;
    } else {
      const ShiftSituation<T> now = {strategy, gears, engine, in, *s, gear};
      s->low_time = strategy.LowTime(now, h);
      choice = strategy.Grants(now) ? strategy.Requested(now) : strategy.Choose(now, h);
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

  // Waits in neutral until the speeds of both sides are nearly equal, then engages the gear. A gear
  // that no longer fits the speed, for example because of hard braking, is replaced.
  void Synchronize(const Engine<T>& engine, const GearboxInput<T>& in, GearboxState<T>* s) const {
    const bool drive = in.mode == in.kDrive;
    const bool wrong = in.mode == in.kNeutral || (s->target > 0) != drive;
    if (s->target == 0 || wrong) {
      s->target = s->phase = s->phase_time = s->gear_time = 0;
      return;
    }
    const T left = Max(synchronization_time - s->phase_time, 0.0) + close_time;
    // A downshift under power skips gears in which the engine is too fast only until the clutch
    // closes.
    const bool skips = s->direction < 0 && in.pedal > engine.pedal_up;
    // The shaft swings when the torque of a low gear ends: an upshift goes by its filtered speed.
    const T speed_now = s->direction > 0 ? s->shaft_speed : in.shaft_speed;
    const T closed = speed_now + (skips ? left : close_time) * s->acceleration;
    if (drive && s->direction < 0 && s->target != in.requested_gear) {
      s->target =
          strategy.Correct({strategy, gears, engine, in, *s, gears.Gear(s->target), left, 0, true});
    }
    if (drive && !strategy.Fits(gears, engine, gears.Gear(s->target), closed)) {
      s->target = GearForSpeed(engine, closed);
    }
    if (s->phase_time < synchronization_time) return;
    const T ratio = gears.Ratio(gears.Gear(s->target));
    const T speed = ratio * in.shaft_speed;
    const T off = abs(in.engine.speed - Max(speed, engine.idle_speed));
    if (off > synchronized_difference && s->phase_time < synchronization_limit) return;
    s->gear = s->target;
    s->phase_time = s->gear_time = 0;
    // Near standstill the clutch is open when the gear engages, and then closes as in a launch.
    const T slowest = strategy.LowSpeed(engine, 0);
    s->phase = Min(speed, ratio * closed) > slowest ? kClose : kInGear;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_GEARBOX_H_
