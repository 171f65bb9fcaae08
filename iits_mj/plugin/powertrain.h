// Powertrain plugin `iits.powertrain`: engine, clutch, automated gearbox, driveline to the wheels.
#ifndef IITS_MJ_PLUGIN_POWERTRAIN_H_
#define IITS_MJ_PLUGIN_POWERTRAIN_H_

#include <mujoco/mujoco.h>

#include <utility>
#include <vector>

#include "plugin/clutch.h"
#include "plugin/endurance.h"
#include "plugin/engine.h"
#include "plugin/gearbox.h"

namespace iits {

// Actuators, by local name: `accelerator_pedal` (force: propeller-shaft torque; transmission: a
// fixed tendon over the driven wheels with coefficients final_drive / n), and optionally
// `engine_brake`, `retarder` and `transmission_mode` on the same tendon (force: 0).
class Powertrain {
 public:
  // All that evolves; zero after a reset, then `initialized` tells the first step to choose a gear.
  struct Core {
    double initialized;
    EngineState engine;
    GearboxState gearbox;
    double torsion;     // of the driveline, at the gearbox input [rad]
    double engagement;  // of the clutch, 0 to 1
    double shaft_torque;
    double fuel_used;  // since the reset [kg]
  };

  // What `compute` found for the present instant; sensors read it.
  struct Output {
    double gear, shift_in_process, engine_speed, engine_torque, indicated_torque, drag_torque;
    double fuel_rate, fuel_used, clutch_engagement, shaft_torque, shaft_speed, pedal;
  };

  struct State {
    EnduranceState endurance;  // first: the brake control reads it
    Core now, next;
    double next_is_fresh;  // `compute` ran since the last `advance`
    Output output;
  };
  static constexpr int kStateSize = sizeof(State) / sizeof(mjtNum);

  static Powertrain* Create(const mjModel* m, int instance);  // null after a warning

  void Actuator(const mjModel* m, mjData* d, int instance) const;
  void Sensors(const mjModel* m, mjData* d, int instance) const;
  void Advance(const mjModel* m, mjData* d, int instance) const;

 private:
  struct Controls {
    double pedal, engine_brake;
    GearboxInput::Mode mode;
    double mass;  // of the vehicle [kg]
  };

  Powertrain() = default;
  bool FindActuators(const mjModel* m, int instance);
  bool FindSensors(const mjModel* m, int instance);
  double VehicleMass(const mjModel* m) const;
  Controls ReadControls(const mjModel* m, const mjData* d) const;
  void Initialize(double shaft_speed, Core* core) const;
  void Step(const Controls& controls, double shaft_speed, double h, Core* core,
            Output* output) const;

  Engine engine_;
  Gearbox gearbox_;
  ClutchControl clutch_control_;
  double clutch_torque_max_, driveline_efficiency_, driveline_stiffness_, driveline_damping_;
  int pedal_ = -1, engine_brake_ = -1, mode_ = -1, retarder_ = -1;  // actuators
  int air_brake_ = -1;                                              // instance
  std::vector<std::pair<int, double (*)(const Powertrain&, const Output&)>> sensors_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_POWERTRAIN_H_
