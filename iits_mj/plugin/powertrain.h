// Powertrain plugin `iits.powertrain`: engine, clutch, automated gearbox, retarder, driveline to
// the wheels.
#ifndef IITS_MJ_PLUGIN_POWERTRAIN_H_
#define IITS_MJ_PLUGIN_POWERTRAIN_H_

#include <mujoco/mujoco.h>

#include <utility>
#include <vector>

#include "plugin/driveline.h"
#include "plugin/endurance.h"
#include "plugin/endurance_control.h"
#include "plugin/engine.h"
#include "plugin/gearbox.h"
#include "plugin/retarder.h"

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
    DrivelineState driveline;
    RetarderState retarder;
    double held_back;        // of the accelerator, by the brakes, 0 to 1
    double shaft_torque;     // behind all losses [N m]
    double retarder_torque;  // at the retarder, >= 0 [N m]
    double fuel_used;        // since the reset [kg]
    EnergyAccount energy;
  };

  // What `compute` found for the present instant, one number a signal; sensors read it.
  struct Output {
    double gear, shift_in_process, engine_speed, engine_torque;
    double engine_torque_percent, torque_loss_percent;
    // As one sensor, these five are `powertrain_report`.
    double gear_engaged, input_shaft_speed;
    double engine_torque_mode, engine_torque_percent_driver, engine_load_percent;
    double fuel_rate, fuel_used, clutch_engagement;
    double propeller_shaft_torque, propeller_shaft_speed, accelerator_pedal_position;
    double engine_brake_torque, engine_brake_torque_percent, engine_brake_torque_percent_intended;
    double engine_brake_torque_percent_available;
    double retarder_torque, retarder_torque_percent, retarder_torque_percent_intended;
    double retarder_torque_percent_available, retarder_heat;
    double engine_work, driveline_loss, clutch_loss, retarder_work, driveline_energy;
  };

  struct State {
    EnduranceState endurance;  // first: the brake control reads it
    Core now, next;
    EnduranceState next_endurance;
    StepWork work;         // of the step that leads to `next`
    double next_is_fresh;  // `compute` ran since the last `advance`
    Output output;
  };
  static constexpr int kStateSize = sizeof(State) / sizeof(mjtNum);

  static Powertrain* Create(const mjModel* m, int instance);  // null after a warning

  void Actuator(const mjModel* m, mjData* d, int instance) const;
  void Sensors(const mjModel* m, mjData* d, int instance) const;
  static int SensorSize(const mjModel* m, int instance, int sensor);
  void Advance(const mjModel* m, mjData* d, int instance) const;

 private:
  struct Controls {
    EnduranceLevers levers;
    GearboxInput::Mode mode;
    EnduranceDemand demand;
    double mass;  // of the vehicle [kg]
  };

  Powertrain() = default;
  bool FindActuators(const mjModel* m, int instance);
  bool FindSensors(const mjModel* m, int instance);
  void FindWheels(const mjModel* m);
  double VehicleMass(const mjModel* m) const;
  Controls ReadControls(const mjModel* m, const mjData* d) const;
  double ShaftSpeed(const mjData* d) const;
  GearData Gear(const GearboxState& gearbox) const;
  EnduranceGearing Gearing(const Core& core) const;
  void Initialize(double shaft_speed, Core* core) const;
  double Engagement(const Core& core, const EngineRequest& request, double pedal,
                    double input_speed, double h) const;
  void Step(const Controls& controls, double shaft_speed, double h, State* s) const;
  void ReportStart(const Core& core, Output* output) const;
  void ReportStep(const EnginePoint& at, const EngineRequest& request,
                  const EnduranceCommand& command, double retarder_max, double pedal,
                  double driver_torque, State* s) const;
  void ReportGears(State* s) const;

  Engine engine_;
  Gearbox gearbox_;
  Driveline driveline_;
  Retarder retarder_;
  EnduranceControl endurance_;
  int pedal_ = -1, engine_brake_ = -1, mode_ = -1, retarder_lever_ = -1;  // actuators
  int air_brake_ = -1;                                                    // instance
  std::vector<std::pair<int, double>> wheels_;  // degree of freedom, its share of the shaft's speed
  std::vector<std::pair<int, int>> sensors_;    // place in sensordata, place in Output
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_POWERTRAIN_H_
