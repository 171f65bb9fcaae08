// Speed tracking: pedal, engine brake, retarder and XBR demand of one control step.
//
// `controllers/tracking/longitudinal.py` describes the law and its settings and has the same
// structures.
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "kernels/driveline_inverse.h"
#include "kernels/interpolation.h"
#include "kernels/kernels.h"

namespace iits {
namespace {

struct Settings {
  double period;
  // `LongitudinalConfig`.
  double speed_gain, integral_gain, integral_max, lead_time, overrun_enter, overrun_leave;
  double retard_enter, coast_error, coast_speed, brake_enter, brake_leave, build_up, dwell;
  double urgent, calm, pedal_rise, pedal_fall, kick_down_gain, endurance_rate, demand_rate;
  double demand_max, stop_speed, go_speed, level, roll_back, hold_demand;
  // The gearbox's condition for a kick-down, and brake control's correction.
  double near_floor, kick, slow_share, trim_max, trim_share;
};

enum Phase { kDrive, kCoast, kOverrun, kBrake, kHold, kLaunch };

struct Memory {
  double phase, since, gear, integral;
  double pedal, slow_pedal, engine_brake, retarder, demand;
  double command[4];
};

struct Truck {
  double time, speed, mass, engine_speed, gear, shifting, grade;
};

double Clip(double value, double low, double high) { return std::min(std::max(value, low), high); }

class SpeedLaw {
 public:
  SpeedLaw(const Settings& settings, const Powertrain& powertrain, const Truck& truck,
           Memory* memory)
      : s_(settings), p_(powertrain), t_(truck), m_(*memory) {}

  // Args: `plan` has time, speed and acceleration of each point.
  void Step(const double* plan, std::ptrdiff_t points) {
    m_.since += s_.period;
    if (t_.gear >= 1.0) m_.gear = t_.gear;
    const Abscissae times(plan, points);
    const double *speeds = plan + points, *accelerations = speeds + points;
    const auto at = [&](const double* values, double time) {
      return times.Value(values, time, times.Find(time));
    };
    const double planned = at(speeds, t_.time), soon = at(speeds, t_.time + 0.5);
    if (Stands(planned, soon)) {
      Hold(soon);
    } else {
      const double gain = *std::max_element(speeds, accelerations) - t_.speed;
      Drive(planned - t_.speed, at(accelerations, t_.time + s_.lead_time), gain);
    }
    Output();
  }

 private:
  void Enter(Phase phase) {
    if (m_.phase != phase) m_.phase = phase, m_.since = 0.0;
  }

  // Whether the truck is at standstill and stays there or starts.
  bool Stands(double planned, double soon) const {
    const bool slow = t_.speed < s_.stop_speed;
    if (m_.phase == kHold || m_.phase == kLaunch) return slow || soon <= s_.go_speed;
    return slow && (std::max(planned, soon) <= s_.go_speed || std::fabs(t_.speed) < 0.05);
  }

  // Uphill a start needs a hold with hill hold, and the truck must not roll back.
  bool MayStart() const {
    if (m_.phase == kLaunch) return t_.speed > -s_.roll_back;
    return (m_.phase == kHold && m_.since >= s_.dwell) || t_.grade < s_.level;
  }

  // Sets the actuators at standstill, and for a start without rolling back.
  void Hold(double soon) {
    m_.integral = m_.engine_brake = m_.retarder = 0.0;
    Enter(soon > s_.go_speed && MayStart() ? kLaunch : kHold);
    if (m_.phase == kHold) {
      m_.pedal = 0.0, m_.demand = s_.hold_demand;
      return;
    }
    // Brake control's hill hold keeps the truck until the driveline does; an XBR demand would
    // cut the engine's torque.
    m_.demand = 0.0;
    const double force = 0.35 * t_.mass + Resistance(p_, t_.mass, 0.1, t_.grade);
    const double engine_speed = std::max(t_.engine_speed, 70.0);
    const double pedal = Actuate(p_, force, 0.1, engine_speed, m_.gear, true, 0.1).pedal;
    m_.pedal = std::min(std::max(pedal, 0.12), m_.pedal + s_.pedal_rise * s_.period);
  }

  // Args: `error` of the speed [m/s]; `ahead`, the planned acceleration; `gain` of speed still to
  // come by the plan [m/s].
  void Drive(double error, double ahead, double gain) {
    if (m_.phase == kCoast) {
      const double held = std::min(std::max(t_.speed, 0.0) / s_.coast_speed, 1.0);
      const double band = s_.coast_error * held;
      error -= Clip(error, -band, band);
    }
    const double wanted = ahead + s_.speed_gain * error + m_.integral;
    double force = (t_.mass + p_.wheel_mass + p_.Spin(m_.gear)) * wanted;
    force += Resistance(p_, t_.mass, t_.speed, t_.grade);
    const bool engaged = !t_.shifting && t_.gear >= 1.0;
    // Engine brake and retarder fade as the truck slows down, so friction must build up before.
    const double later = std::max(t_.speed + std::min(wanted, 0.0) * s_.build_up, 0.0);
    const Actuation split = Actuate(p_, force, t_.speed, t_.engine_speed, m_.gear, engaged, later);
    Choose(split, wanted, engaged);
    Pull(split.pedal, gain);
    Retard(split, wanted, engaged);
    Brake(force, wanted);
    Learn(error);
  }

  // Chooses the next phase, with hysteresis and dwell time; waits for gear changes.
  void Choose(const Actuation& split, double wanted, bool engaged) {
    const double above = split.torque + split.drag, deficit = split.lacking / t_.mass;
    if (m_.phase == kHold || m_.phase == kLaunch) Enter(kDrive);
    const bool urgent = wanted < -s_.urgent;
    if ((m_.since < s_.dwell || !engaged) && !urgent) return;
    if (m_.phase == kBrake) {
      if (deficit < s_.brake_leave && wanted > -s_.calm) {
        Enter(above > s_.overrun_leave ? kDrive : kOverrun);
      }
    } else if (urgent || deficit > s_.brake_enter) {
      Enter(kBrake);
    } else if (m_.phase == kOverrun) {
      if (above > s_.overrun_leave) {
        Enter(kDrive);
      } else if (above > 0.0) {
        Enter(kCoast);
      }
    } else if (split.beyond / t_.mass > s_.retard_enter) {
      Enter(kOverrun);
    } else if (m_.phase == kDrive && above < -s_.overrun_enter) {
      Enter(kCoast);
    } else if (m_.phase == kCoast && above > s_.overrun_leave) {
      Enter(kDrive);
    }
  }

  // Sets the accelerator within its rates; released in every phase but DRIVE, at rest in a change.
  void Pull(double pedal, double gain) {
    if (m_.phase != kDrive) {
      m_.pedal = 0.0;
      return;
    }
    if (t_.shifting) pedal = m_.pedal;
    if (gain < s_.kick_down_gain) {
      pedal = std::min(pedal, Clip(m_.slow_pedal + s_.kick, s_.near_floor, 1.0));
    }
    const double lowest = m_.pedal - s_.pedal_fall * s_.period;
    m_.pedal = std::min(std::max(pedal, lowest), m_.pedal + s_.pedal_rise * s_.period);
  }

  // Sets engine brake and retarder; a gear change keeps the engine brake's request.
  void Retard(const Actuation& split, double wanted, bool engaged) {
    double engine_brake = engaged ? split.engine_brake : m_.engine_brake;
    double retarder = split.retarder;
    if (m_.phase == kDrive || m_.phase == kCoast || wanted < -s_.urgent) {
      engine_brake = retarder = 0.0;
    }
    const double reach = s_.endurance_rate * s_.period;
    m_.engine_brake += Clip(engine_brake - m_.engine_brake, -reach, reach);
    m_.retarder += Clip(retarder - m_.retarder, -reach, reach);
  }

  // Sets the XBR demand for a force at the wheels [N], negative when it brakes.
  void Brake(double force, double wanted) {
    double demand = 0.0;
    if (m_.phase == kBrake) {
      // Brake control includes rolling resistance and slows the wheels as well.
      double level = p_.rolling * (t_.mass * kGravity) - force;
      level /= t_.mass + p_.wheel_mass;
      // On a descent the least demand whose correction by brake control reaches the level.
      const double least = std::max(0.5 * level, (level - s_.trim_max) / (1.0 + s_.trim_share));
      demand = std::max(std::max(-wanted, least), 0.0);
      demand = Clip(demand, 1e-3, s_.demand_max);
    }
    const double rise = (wanted < -2.5 ? 10.0 : s_.demand_rate) * s_.period;
    m_.demand = std::min(demand, m_.demand + rise);
  }

  // Updates the integral, except at the actuators' limits, coasting and in gear changes.
  void Learn(double error) {
    const bool stuck =
        (m_.pedal >= 1.0 && error > 0.0) || (m_.demand >= s_.demand_max && error < 0.0);
    const bool idle = m_.engine_brake <= 0.0 && m_.retarder <= 0.0;
    const bool coasting = m_.phase == kCoast || (m_.phase == kOverrun && idle && error < 0.0);
    if (stuck || coasting || t_.shifting || t_.speed < 1.0) return;
    const double grown = m_.integral + s_.integral_gain * error * s_.period;
    m_.integral = Clip(grown, -s_.integral_max, s_.integral_max);
  }

  void Output() {
    const auto share = [](double value) { return value <= 0.0 ? 0.0 : std::min(value, 1.0); };
    const double pedal = share(m_.pedal);
    m_.slow_pedal += s_.slow_share * (pedal - m_.slow_pedal);
    const double command[] = {pedal, m_.demand, share(m_.engine_brake), share(m_.retarder)};
    std::copy(command, command + 4, m_.command);
  }

  const Settings& s_;
  const Powertrain& p_;
  const Truck& t_;
  Memory& m_;
};

}  // namespace
}  // namespace iits

// Returns the phase. Args: `plan` has time, speed and acceleration of its points; the last values
// are those of the truck, its speeds [m/s] and [rad/s], and the grade under it.
IITS_KERNEL std::ptrdiff_t iits_track_speed(const iits::Settings* settings,
                                            const iits::Powertrain* powertrain,
                                            iits::Memory* memory, const double* plan,
                                            std::ptrdiff_t points, double time, double speed,
                                            double mass, double engine_speed, double gear,
                                            double shifting, double grade) {
  const iits::Truck truck = {time, speed, mass, engine_speed, gear, shifting, grade};
  iits::SpeedLaw(*settings, *powertrain, truck, memory).Step(plan, points);
  return static_cast<std::ptrdiff_t>(memory->phase);
}
