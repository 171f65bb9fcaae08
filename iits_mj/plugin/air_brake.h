// Air brake plugin `iits.air_brake`: XBR control, pneumatics, ABS, wheel brakes, parking brake.
#ifndef IITS_MJ_PLUGIN_AIR_BRAKE_H_
#define IITS_MJ_PLUGIN_AIR_BRAKE_H_

#include <mujoco/mujoco.h>

#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "plugin/brake_control.h"
#include "plugin/dead_time.h"
#include "plugin/wheel_brake.h"

namespace iits {

// Hubs (the bodies that do not spin) reference the instance: in body order, left and right of each
// axle, each with one child body on one hinge, the wheel. Actuators, by local name: `xbr_demand`,
// `xbr_mode` and optionally `parking_brake`; they exert no force themselves.
class AirBrake {
 public:
  static constexpr int kAxlesMax = 8;
  static constexpr int kWheelsMax = 2 * kAxlesMax;

  struct Pneumatics {
    BrakeControlState control;
    DeadTimeLine line;
    WheelBrakeState wheel[kWheelsMax];
    double parking;  // share of the spring brakes that is applied
  };
  struct WindUp {
    double angle[kWheelsMax];   // of the brakes' elastic parts [rad]
    double torque[kWheelsMax];  // that went with it [N m]
  };

  struct State {
    Pneumatics now, next;
    WindUp wind_up, next_wind_up;
    double next_is_fresh, next_wind_up_is_fresh;  // computed since the last `advance`
    double xbr_active, abs_active;
  };
  static constexpr int kStateSize = sizeof(State) / sizeof(mjtNum);

  static AirBrake* Create(const mjModel* m, int instance);  // null after a warning

  void Passive(const mjModel* m, mjData* d, int instance) const;
  void Actuator(const mjModel* m, mjData* d, int instance) const;
  void Sensors(const mjModel* m, mjData* d, int instance) const;
  void Advance(const mjModel* m, mjData* d, int instance) const;

 private:
  using Signal = std::function<double(const State&)>;

  AirBrake() = default;
  bool ReadAxles(const mjModel* m, int instance);
  bool FindActuators(const mjModel* m, int instance);
  bool FindSensors(const mjModel* m, int instance);
  Signal FindSignal(const std::string& name) const;
  double HubSpeed(const mjModel* m, const mjData* d, int hub) const;
  BrakeDemand ReadDemand(const mjModel* m, const mjData* d, const State& s) const;

  BrakeControl control_;
  std::vector<WheelBrake> wheels_;
  double sample_spacing_ = 0;                    // of the dead-time line [s]
  int demand_ = -1, mode_ = -1, parking_ = -1;   // actuators
  std::vector<std::pair<int, Signal>> sensors_;  // address, value
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_AIR_BRAKE_H_
