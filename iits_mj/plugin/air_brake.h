// Air brake plugin `iits.air_brake`: brake control, pneumatics, ABS, wheel brakes, parking brake.
#ifndef IITS_MJ_PLUGIN_AIR_BRAKE_H_
#define IITS_MJ_PLUGIN_AIR_BRAKE_H_

#include <mujoco/mujoco.h>

#include <string>
#include <vector>

#include "plugin/brake_control.h"
#include "plugin/dead_time.h"
#include "plugin/endurance.h"
#include "plugin/reservoir.h"
#include "plugin/wheel_brake.h"

namespace iits {

// Hubs (the bodies that do not spin) reference the instance: in body order, left and right of each
// axle, each with one child body on one hinge, the wheel. Actuators, by local name: `xbr_demand`,
// `xbr_mode` and optionally `parking_brake`, `brake_pedal`, `xbr_ebi_mode`; they exert no force
// themselves. Where the transmission of `xbr_demand` is a fixed tendon over driven wheels, that is
// the propeller shaft, and an `iits.powertrain` beside it helps to brake.
class AirBrake {
 public:
  static constexpr int kAxlesMax = 8;
  static constexpr int kWheelsMax = 2 * kAxlesMax;

  struct Pneumatics {
    BrakeControlState control;
    ReservoirState reservoir;
    double parking[kCircuits];          // share of the spring brakes that is applied
    WheelBrakeState wheel[kWheelsMax];  // last: only those that there are get copied
  };
  struct WindUp {
    double angle[kWheelsMax];   // of the brakes' elastic parts [rad]
    double torque[kWheelsMax];  // that went with it [N m]
  };

  struct State {
    EnduranceDemand endurance;  // first: the powertrain reads it
    EnduranceDemand next_endurance;
    Pneumatics now, next;
    DeadTimeLine line;
    WindUp wind_up, next_wind_up;
    double next_is_fresh, next_wind_up_is_fresh;  // computed since the last `advance`
    double xbr_active, abs_active;
    double work;       // that the brakes have taken from the wheels since the reset [J]
    double next_work;  // half of the next step's, with the wheel speeds at its start [J]
  };
  static constexpr int kStateSize = sizeof(State) / sizeof(mjtNum);

  static AirBrake* Create(const mjModel* m, int instance);  // null after a warning

  static int SensorSize(const mjModel* m, int instance, int sensor);

  void Passive(const mjModel* m, mjData* d, int instance) const;
  void Actuator(const mjModel* m, mjData* d, int instance) const;
  void Sensors(const mjModel* m, mjData* d, int instance) const;
  void Advance(const mjModel* m, mjData* d, int instance) const;

 private:
  // Brake line to wheels that have its dead time in common.
  struct Line {
    int circuit;
    double dead_time;
  };
  // A sensor's value is the mean of some numbers of the state; 0 of none.
  struct Sensor {
    int address;
    int begin, end;  // of their places in the state, in places_
    double share;    // of each
  };

  AirBrake() = default;
  bool ReadWheels(const mjModel* m, int instance);
  bool FindJoints(const mjModel* m, int instance);
  void ArrangeLines(const mjModel* m);
  bool FindActuators(const mjModel* m, int instance);
  void FindShaft(const mjModel* m);
  bool FindSensors(const mjModel* m, int instance);
  bool FindSignal(const std::string& name, std::vector<int>* places) const;
  double HubSpeed(const mjModel* m, const mjData* d, int hub) const;
  double Control(const mjModel* m, const mjData* d, int actuator, double low, double high) const;
  WheelBrakeRates Rates(size_t wheel, double h) const {
    return h == rates_[wheel].step ? rates_[wheel] : wheels_[wheel].Rates(h);
  }
  BrakeDemand ReadDemand(const mjModel* m, const mjData* d, const State& s) const;
  void Copy(const Pneumatics& from, Pneumatics* to) const;
  void Brake(const mjModel* m, const mjData* d, State* s) const;
  bool Quiet(const State& s, double h) const;
  void Park(double wanted, double h, Pneumatics* next) const;

  BrakeControl control_;
  Reservoirs reservoirs_;
  std::vector<WheelBrake> wheels_;
  std::vector<WheelBrakeRates> rates_;  // of each wheel, for the model's time step
  std::vector<Line> lines_;
  std::vector<int> line_of_wheel_;
  double dead_time_max_ = 0;              // [s]
  double sample_spacing_ = 0;             // of the dead-time line [s]
  double parking_time_constant_ = 0;      // [s]
  double spring_volume_[kCircuits] = {};  // of the spring brakes' chambers [m3]
  int demand_ = -1, mode_ = -1, parking_ = -1, pedal_ = -1, ebi_mode_ = -1;  // actuators
  int powertrain_ = -1;                                                      // instance
  double shaft_ratio_ = 0;  // force at the driven wheels per torque of the propeller shaft [1/m]
  std::vector<Sensor> sensors_;
  std::vector<int> places_;
  int speeds_ = -1;  // place of the sensor `wheel_speeds` in sensordata
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_AIR_BRAKE_H_
