// Automated gearbox: which gear, and the sequence of a gear change.
#ifndef IITS_MJ_PLUGIN_GEARBOX_H_
#define IITS_MJ_PLUGIN_GEARBOX_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "plugin/engine.h"
#include "plugin/lookup.h"

namespace iits {

// What the gearbox remembers between steps; whole numbers are kept as doubles.
struct GearboxState {
  double gear;          // engaged: 1 to n, 0 neutral, -1 reverse
  double target;        // gear that is wanted, equal to `gear` outside a change
  double phase;         // Gearbox::Phase
  double phase_time;    // since the phase began [s]
  double gear_time;     // since the last change ended [s]
  double low_time;      // for how long a lower gear has been called for [s]
  double shaft_speed;   // propeller shaft, low-passed [rad/s]
  double acceleration;  // of the propeller shaft, filtered [rad/s2]
  double load;          // filtered torque that would keep the shaft's speed [N m]
};

// What the gearbox controller sees.
struct GearboxInput {
  enum Mode { kDrive = 0, kNeutral = 1, kReverse = 2 };
  Mode mode;
  double pedal, engine_brake;
  double shaft_speed, shaft_torque;  // propeller shaft [rad/s], [N m]
  double engine_speed;
  bool clutch_open;
};

class Gearbox {
 public:
  enum Phase { kInGear = 0, kCut, kSynchronize, kClose };

  // Reads the attributes; false after a warning. `mass` is that of the whole vehicle.
  bool Read(const mjModel* m, int instance, double mass);

  int count() const { return static_cast<int>(ratios_.size()); }
  double Ratio(int gear) const;         // 0 in neutral, negative in reverse
  double InputInertia(int gear) const;  // at the gearbox input [kg m2]
  double Efficiency() const { return efficiency_; }
  double final_drive() const { return final_drive_; }
  double close_time() const { return close_time_; }

  // Gear for a vehicle that is found rolling at this speed.
  int GearForSpeed(const Engine& engine, double shaft_speed) const;
  // Filters, gear choice, and the sequence of a change, by one step.
  void Update(const Engine& engine, const GearboxInput& in, double h, GearboxState* s) const;
  // What the engine has to do for the gearbox; `kPedal` in gear.
  EngineRequest Request(const Engine& engine, const GearboxInput& in, const GearboxState& s) const;

 private:
  void Filter(const GearboxInput& in, double h, GearboxState* s) const;
  int Choose(const Engine& engine, const GearboxInput& in, const GearboxState& s) const;
  int Upshift(const Engine& engine, const GearboxInput& in, const GearboxState& s, int gear) const;
  int Downshift(const Engine& engine, const GearboxInput& in, const GearboxState& s,
                int gear) const;
  bool CallsForLower(const Engine& engine, const GearboxInput& in, const GearboxState& s) const;
  double LowSpeed(const Engine& engine, double pedal) const;
  double Speed(double shaft_speed) const { return shaft_speed * meters_per_radian_; }
  // Expected shaft speed when a change that begins now is over.
  double SpeedAfterChange(const GearboxState& s, bool powered) const;

  double final_drive_, efficiency_, reverse_ratio_;
  double cut_time_, synchronization_time_, close_time_;
  double downshift_delay_, downshift_margin_, min_gear_time_;
  double start_gear_;
  double meters_per_radian_;  // of the propeller shaft
  double vehicle_inertia_;    // of the vehicle's mass about the propeller shaft [kg m2]
  std::vector<double> ratios_, inertias_;
  Map upshift_, downshift_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_GEARBOX_H_
