// Automated gearbox: the gears, and the sequence of a gear change.
#ifndef IITS_MJ_PLUGIN_GEARBOX_H_
#define IITS_MJ_PLUGIN_GEARBOX_H_

#include <mujoco/mujoco.h>

#include "plugin/engine.h"
#include "plugin/gears.h"
#include "plugin/shift_strategy.h"

namespace iits {

class Gearbox {
 public:
  enum Phase { kInGear = 0, kCut, kSynchronize, kClose };

  // Reads the attributes; false after a warning.
  bool Read(const mjModel* m, int instance);

  double Ratio(int gear) const { return gears_.Ratio(gear); }
  double InputInertia(int gear) const { return gears_.InputInertia(gear); }
  double Efficiency() const { return gears_.gear_efficiency; }
  double final_drive() const { return gears_.final_drive; }
  double close_time() const { return close_time_; }

  // Gear for a vehicle that is found rolling at this speed.
  int GearForSpeed(const Engine& engine, double shaft_speed) const {
    return strategy_.GearForSpeed(gears_, engine, shaft_speed);
  }
  // Filters, gear choice, and the sequence of a change, by one step.
  void Update(const Engine& engine, const GearboxInput& in, double h, GearboxState* s) const;
  // What the engine has to do for the gearbox; `kPedal` in gear.
  EngineRequest Request(const Engine& engine, const GearboxInput& in, const GearboxState& s) const;

 private:
  bool ReadGears(const mjModel* m, int instance);
  void Choose(const Engine& engine, const GearboxInput& in, double h, GearboxState* s) const;
  void Synchronize(const Engine& engine, const GearboxInput& in, GearboxState* s) const;

  Gears gears_;
  ShiftStrategy strategy_;
  double cut_time_, synchronization_time_, synchronization_limit_, close_time_;
  double synchronized_difference_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_GEARBOX_H_
