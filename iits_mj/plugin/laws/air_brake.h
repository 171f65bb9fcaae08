// The whole air brake: control, lines, chambers with ABS, spring brakes, reservoirs, wheel brakes.
#ifndef IITS_MJ_PLUGIN_LAWS_AIR_BRAKE_H_
#define IITS_MJ_PLUGIN_LAWS_AIR_BRAKE_H_

#include <algorithm>
#include <vector>

#include "plugin/laws/brake_control.h"
#include "plugin/laws/dead_time.h"
#include "plugin/laws/drive_slip.h"
#include "plugin/laws/endurance.h"
#include "plugin/laws/reservoir.h"
#include "plugin/laws/wheel_brake.h"

namespace iits {

inline constexpr int kAxlesMax = 16;
inline constexpr int kWheelsMax = 2 * kAxlesMax;

template <class T>
struct BrakePneumatics {
  BrakeControlState<T> control;
  ReservoirState<T> reservoir;
  DriveSlipState<T> drive_slip;
  T past_slip[kWheelsMax];               // of the driven wheels, a step before
  T parking[kCircuits];                  // share of the spring brakes that is applied
  WheelBrakeState<T> wheel[kWheelsMax];  // only those of existing wheels are used
};

template <class T>
struct BrakeWindUp {
  T angle[kWheelsMax];   // of the brakes' elastic parts [rad]
  T torque[kWheelsMax];  // on the wheel, against forward rotation [N m]
};

// Faults, set from outside; all zero: none.
template <class T>
struct BrakeFaults {
  T leak[kCircuits];    // rate at which a reservoir empties [1/s]
  T stuck[kWheelsMax];  // 1: a wheel-speed sensor shows `shown`
  T shown[kWheelsMax];  // [rad/s]
  T doubt[kWheelsMax];  // for how long the speed of a wheel has not been plausible [s]
};

template <class T>
struct AirBrakeState {
  EnduranceDemand<T> endurance;  // first: the powertrain reads it
  EnduranceDemand<T> next_endurance;
  BrakePneumatics<T> now, next;
  DeadTimeLine<T> line;
  BrakeWindUp<T> wind_up, next_wind_up;
  T next_is_fresh, next_wind_up_is_fresh;  // computed since the last commit
  T xbr_active, abs_active;
  T asr_engine_active, asr_brake_active, drag_control_active;
  T work;                 // of the brakes on the wheels since the reset [J]
  T next_work;            // half of the next step's work, with the wheel speeds at its start [J]
  T speed;                // of the vehicle [m/s]
  BrakeFaults<T> faults;  // last
};

// Order of the wheels: left and right of each axle, axle by axle.
template <class T>
struct AirBrake {
  using State = AirBrakeState<T>;
  using Pneumatics = BrakePneumatics<T>;

  BrakeControl<T> control;
  Reservoirs<T> reservoirs;
  DriveSlipControl<T> drive_slip;
  std::vector<WheelBrake<T>> wheels;
  T parking_time_constant = 0;  // [s]
  std::vector<size_t> driven;   // wheels on the propeller shaft
  T shaft_ratio = 0;  // force at the driven wheels per torque of the propeller shaft [1/m]

  // Computes the constants that depend on the wheels and the time step.
  void Prepare(T h) {
    T response = 0;
    const auto in_the_air = std::count_if(wheels.begin(), wheels.end(),
                                          [](const WheelBrake<T>& wheel) { return wheel.lifted; });
    const T grounded = static_cast<double>(wheels.size() - in_the_air);
    for (const WheelBrake<T>& wheel : wheels) {
      if (wheel.parking_torque > 0) spring_volume_[wheel.circuit] += wheel.chamber_volume;
      if (!wheel.lifted) {
        control.AddWheel(wheel.circuit, wheel.wheel_radius, wheel.inertia,
                         wheel.torque_per_pressure);
        dead_time_max_ = Max(dead_time_max_, wheel.dead_time);
        response += (wheel.dead_time + wheel.build_up_time_constant) / grounded;
      }
      auto same = [&wheel](const Line& l) {
        return l.circuit == wheel.circuit && l.dead_time == wheel.dead_time;
      };
      auto place = std::find_if(lines_.begin(), lines_.end(), same);
      line_of_wheel_.push_back(static_cast<int>(place - lines_.begin()));
      if (place == lines_.end()) lines_.push_back({wheel.circuit, wheel.dead_time});
      rates_.push_back(wheel.Rates(h));
    }
    sample_spacing_ = dead_time_max_ / (DeadTimeLine<T>::kSlots - 2);
    control.response_time = response;
  }

  // Speed of a wheel as its sensor shows it.
  static T Sensed(const State& s, size_t i, T wheel_speed) {
    return s.faults.stuck[i] != 0 ? s.faults.shown[i] : wheel_speed;
  }

  // Brake torque of a wheel from the committed pressures, against its rotation; 0 without pressure.
  // Adds the power of the brake to `power`.
  T Torque(size_t i, T wheel_speed, T h, State* s, T* power) const {
    const T capacity = wheels[i].Torque(s->now.wheel[i], s->now.parking[wheels[i].circuit]);
    s->next_wind_up.angle[i] = s->next_wind_up.torque[i] = 0;
    if (capacity == 0) return 0;
    T angle = s->wind_up.angle[i];
    const T torque = WheelBrake<T>::Grip(Rates(i, h), capacity, wheel_speed, &angle);
    s->next_wind_up.angle[i] = angle;
    s->next_wind_up.torque[i] = torque;
    *power += torque * wheel_speed;
    return torque;
  }

  // Pressures of the next step from the demand of this one, which Step completes with the state of
  // the brakes. `shaft` is the message of the powertrain, `parking` the driver's spring-brake
  // control, 0 to 1; `hub_speed(i)` and `wheel_speed(i)` return a wheel end's forward speed [m/s]
  // and rotation [rad/s].
  template <class HubSpeed, class WheelSpeed>
  void Step(BrakeDemand<T> demand, const EnduranceState<T>& shaft, T parking, T h,
            const HubSpeed& hub_speed, const WheelSpeed& wheel_speed, State* s) const {
    Pneumatics* next = &s->next;
    Copy(s->now, next);
    if (next->control.initialized == 0) reservoirs.Fill(&next->reservoir);
    demand.abs_active = demand.abs_on_drive = false;
    demand.uphill_torque = 0;
    for (size_t i = 0; i < wheels.size(); ++i) {
      const bool abs = s->now.wheel[i].abs_active != 0;
      demand.abs_active = demand.abs_active || abs;
      demand.abs_on_drive = demand.abs_on_drive || (abs && wheels[i].circuit == kDrive);
      demand.uphill_torque -= s->wind_up.torque[i];
    }
    demand.shaft_force = shaft_ratio * shaft.shaft_torque;
    demand.shaft_force_max = shaft_ratio * shaft.shaft_torque_max;
    demand.reservoir = next->reservoir.pressure;
    const BrakeEffort<T> effort = control.Update(demand, h, &next->control);
    T asr[kWheelsMax];
    auto sensed = [&wheel_speed, s](size_t i) { return Sensed(*s, i, wheel_speed(i)); };
    const bool spinning = ControlSlip(effort.active, h, hub_speed, sensed, asr, s);
    if (spinning || !Quiet(*s, h)) Brake(h, hub_speed, sensed, spinning ? asr : nullptr, s);
    Park(parking, h, next);
    reservoirs.Pump(shaft.engine_speed, h, &next->reservoir);
    for (int i = 0; i < kCircuits; ++i) {
      next->reservoir.pressure[i] /= 1 + h * Max(0.0, s->faults.leak[i]);
    }
    s->speed = demand.speed;
    s->next_endurance.shaft_torque = shaft_ratio > 0 ? effort.shaft_force / shaft_ratio : T(0);
    if (demand.abs_on_drive) s->next_endurance.shaft_torque = EnduranceDemand<T>::kRelease;
    s->next_is_fresh = 1;
    s->xbr_active = demand.xbr > 0 && demand.xbr_mode != demand.kOff;
    s->abs_active = demand.abs_active;
  }

  // Commits the parts of the state that were computed since the last commit.
  template <class WheelSpeed>
  void Commit(T h, const WheelSpeed& wheel_speed, State* s) const {
    if (s->next_is_fresh != 0) {
      Copy(s->next, &s->now);
      s->line.Push(s->now.control.supply, h, sample_spacing_);
      s->endurance = s->next_endurance;
      for (size_t i = 0; i < wheels.size() && s->speed > kMonitorSpeed; ++i) {
        if (wheels[i].lifted) continue;  // turns at any speed
        const T rolled = Sensed(*s, i, wheel_speed(i)) * wheels[i].wheel_radius;
        s->faults.doubt[i] = rolled < kMonitorShare * s->speed ? s->faults.doubt[i] + h : T(0);
      }
    }
    if (s->next_wind_up_is_fresh != 0) {
      // Torque times the mean of the wheel speeds before and after the step is the change of the
      // kinetic energy. The present wheel speeds are those after the step.
      T power = 0;
      for (size_t i = 0; i < wheels.size(); ++i) {
        s->wind_up.angle[i] = s->next_wind_up.angle[i];
        s->wind_up.torque[i] = s->next_wind_up.torque[i];
        power += s->wind_up.torque[i] * wheel_speed(i);
      }
      s->work += s->next_work + 0.5 * h * power;
    }
    s->next_is_fresh = s->next_wind_up_is_fresh = 0;
  }

 private:
  // ABS ignores a sensor that shows less than a share of the vehicle's speed for this time: no
  // wheel that ABS releases stays so slow so long. Estimated.
  static constexpr double kMonitorSpeed = 3, kMonitorShare = 0.5, kDoubtMax = 2;  // [m/s], [1], [s]

  // Brake line to wheels with the same dead time.
  struct Line {
    int circuit;
    T dead_time;
  };

  WheelBrakeRates<T> Rates(size_t i, T h) const {
    return h == rates_[i].step ? rates_[i] : wheels[i].Rates(h);
  }

  void Copy(const Pneumatics& from, Pneumatics* to) const {
    to->control = from.control;
    to->reservoir = from.reservoir;
    to->drive_slip = from.drive_slip;
    std::copy(from.past_slip, from.past_slip + wheels.size(), to->past_slip);
    std::copy(from.parking, from.parking + kCircuits, to->parking);
    std::copy(from.wheel, from.wheel + wheels.size(), to->wheel);
  }

  // No pressure in valves, lines and chambers, the most frequent case.
  bool Quiet(const State& s, T h) const {
    T pressure = 0;
    for (const T& supply : s.next.control.supply) pressure += supply;
    for (size_t i = 0; i < wheels.size(); ++i) pressure += s.now.wheel[i].effective;
    return pressure == 0 && s.line.clock + h - s.line.last_used > dead_time_max_;
  }

  // Engine: the brakes cut the accelerator, and traction control a share of it; drag-torque control
  // only takes the drag away while the brakes act. Brakes: returns whether traction control brakes
  // wheels, with the pressures `asr` [Pa].
  template <class HubSpeed, class WheelSpeed>
  bool ControlSlip(bool braking, T h, const HubSpeed& hub_speed, const WheelSpeed& wheel_speed,
                   T asr[kWheelsMax], State* s) const {
    EnduranceDemand<T>* engine = &s->next_endurance;
    engine->cut_traction = braking;
    DriveSlip<T> slip, coming;  // present, and extrapolated to the step in which the brakes act
    T coming_slips[kWheelsMax];
    T dragged = 0;  // slip that is not the friction brake's, or that its ABS does not end
    for (size_t i : driven) {
      coming_slips[i] = 0;
      if (s->faults.doubt[i] > kDoubtMax) continue;
      const WheelBrakeState<T>& brake = s->now.wheel[i];
      const T present = wheels[i].Slip(hub_speed(i), wheel_speed(i));
      slip.Add(present);
      coming.Add(coming_slips[i] = 2 * present - s->now.past_slip[i]);
      s->next.past_slip[i] = present;
      const bool braked = brake.effective > wheels[i].push_out_pressure;
      if (!braked || brake.abs_active != 0) dragged = Max(dragged, present);
    }
    if (slip.count == 0) {  // no driven wheel, or none with a plausible speed
      engine->drag_relief = engine->traction_cut = 0;
      s->asr_engine_active = s->asr_brake_active = s->drag_control_active = 0;
      return false;
    }
    const T speed = hub_speed(0);
    const T relief = drive_slip.Drag(dragged, speed, h, &s->next.drive_slip);
    const T cut = drive_slip.Traction(slip, speed, h, &s->next.drive_slip);
    engine->drag_relief = braking ? Min(relief, EnduranceDemand<T>::kNoDrag) : relief;
    engine->cut_traction = Max(engine->cut_traction, cut);
    s->drag_control_active = relief > 0;
    s->asr_engine_active = engine->traction_cut = cut > 0 && !braking;
    s->asr_brake_active = 0;
    if (braking) return false;
    std::fill(asr, asr + wheels.size(), T(0));
    for (size_t i : driven) {
      const T pressure = drive_slip.Pressure(coming, coming_slips[i], speed);
      asr[i] = Min(pressure, s->next.reservoir.pressure[wheels[i].circuit]);
      if (asr[i] > 0) s->asr_brake_active = 1;
    }
    return s->asr_brake_active != 0;
  }

  // From the supply valves, or those of traction control, to the chambers.
  template <class HubSpeed, class WheelSpeed>
  void Brake(T h, const HubSpeed& hub_speed, const WheelSpeed& wheel_speed, const T* asr,
             State* s) const {
    const Pneumatics& now = s->now;
    Pneumatics* next = &s->next;
    T supplies[kWheelsMax], duty[kWheelsMax];
    for (size_t i = 0; i < lines_.size(); ++i) {
      const T current = next->control.supply[lines_[i].circuit];
      supplies[i] = s->line.Look(lines_[i].circuit, lines_[i].dead_time, h, current);
    }
    for (size_t i = 0; i < wheels.size(); ++i) {
      // Behind the hysteresis: a chamber that is being emptied may still brake its wheel.
      const bool braked = now.wheel[i].effective > wheels[i].push_out_pressure;
      duty[i] = wheels[i].Duty(Rates(i, h), now.wheel[i], braked ? hub_speed(i) : T(0),
                               wheel_speed(i), &next->wheel[i].slip);
      if (s->faults.doubt[i] > kDoubtMax) duty[i] = 1;  // no ABS without a plausible speed
    }
    for (size_t i = 0; i < wheels.size(); i += 2) {  // axle by axle
      // Driven axles are controlled by the wheel with less grip (select low), others individually.
      if (wheels[i].circuit == kDrive) duty[i] = duty[i + 1] = Min(duty[i], duty[i + 1]);
      for (size_t j : {i, i + 1}) {
        const T supply = supplies[line_of_wheel_[j]];
        next->wheel[j].abs_active = wheels[j].Active(supply, duty[j], now.wheel[j]);
      }
    }
    for (size_t i = 0; i < wheels.size(); ++i) {
      const WheelBrake<T>& wheel = wheels[i];
      const T line = wheel.lifted ? T(0) : supplies[line_of_wheel_[i]];
      const T supply = asr ? Max(line, asr[i]) : line;
      WheelBrakeState<T>* chamber = &next->wheel[i];
      if (supply == 0 && chamber->pressure == 0) continue;
      const WheelBrakeRates<T> rates = Rates(i, h);
      const size_t other = i ^ 1;  // wheel of the axle
      const bool other_active = next->wheel[other].abs_active != 0;
      const bool refills = chamber->abs_active != 0 && s->faults.doubt[i] <= kDoubtMax;
      const T rise_max =
          wheel.RiseMax(rates, now.wheel[i], refills, now.wheel[other], other_active);
      const T before = wheel.Air(*chamber);
      wheel.Update(rates, supply, rise_max, duty[i], chamber);
      const T drawn = wheel.Air(*chamber) - before;
      if (drawn > 0) reservoirs.Draw(wheel.circuit, drawn, &next->reservoir);
    }
  }

  // Spring brakes: applied on the driver's demand, or because the air to release them is missing.
  void Park(T wanted, T h, Pneumatics* next) const {
    for (int i = 0; i < kCircuits; ++i) {
      const T target = Max(wanted, reservoirs.Springs(i, next->reservoir));
      if (next->parking[i] == target) continue;
      const T change = LagShare(h, parking_time_constant) * (target - next->parking[i]);
      next->parking[i] += change;
      if (abs(target - next->parking[i]) < 1e-6) next->parking[i] = target;
      if (change < 0) {  // air fills the chambers, which releases the springs
        const T air = spring_volume_[i] * (next->reservoir.pressure[i] + kAtmosphere);
        reservoirs.Draw(i, -change * air, &next->reservoir);
      }
    }
  }

  std::vector<WheelBrakeRates<T>> rates_;  // of each wheel, for the model's time step
  std::vector<Line> lines_;
  std::vector<int> line_of_wheel_;
  T sample_spacing_ = 0;             // of the dead-time line [s]
  T dead_time_max_ = 0;              // [s]
  T spring_volume_[kCircuits] = {};  // of the spring brakes' chambers [m3]
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_AIR_BRAKE_H_
