// From the crankshaft to the propeller shaft: clutch, gears, losses, and the energy that each
// takes.
#ifndef IITS_MJ_PLUGIN_DRIVELINE_H_
#define IITS_MJ_PLUGIN_DRIVELINE_H_

#include <mujoco/mujoco.h>

#include "plugin/clutch.h"

namespace iits {

// Energies since the reset [J].
struct EnergyAccount {
  double engine_work;    // at the flywheel, negative in overrun
  double clutch_loss;    // slip, damping, synchronizing
  double gear_loss;      // gears and final drive
  double retarder_work;  // turned into heat, >= 0
};

// What the driveline remembers between steps.
struct DrivelineState {
  double torsion;     // at the gearbox input [rad]
  double engagement;  // of the clutch, 0 to 1
  double inertia;     // that turned with the crankshaft in the last step [kg m2]
  double stiffness;   // of the last step, at the gearbox input [N m/rad]
};

// Torques of one step. Its work is booked when the speed at its end is known, with the mean speed:
// h T (w + w') / 2 is exactly what the torque adds to the kinetic energy of a constant inertia.
struct StepWork {
  double engine_work, clutch_work;  // flywheel to clutch; clutch to gears, less what is stored
  double gear_torque, retarder_torque, shaft_torque;  // at the propeller shaft [N m]
  double shaft_speed;                                 // at the step's start [rad/s]

  void Book(double end_speed, double h, EnergyAccount* account) const {
    const double angle = 0.5 * h * (shaft_speed + end_speed);
    account->engine_work += engine_work;
    account->clutch_loss += clutch_work - angle * gear_torque;
    account->gear_loss += angle * (gear_torque - retarder_torque - shaft_torque);
    account->retarder_work += angle * retarder_torque;
  }
};

// The gear that is in, as the driveline sees it.
struct GearData {
  double ratio;       // 0: none, negative in reverse
  double inertia;     // with the crankshaft's [kg m2]
  double efficiency;  // of the gears
};

class Driveline {
 public:
  // Reads the attributes; false after a warning. The rest of the clutch's figures come from others.
  bool Read(const mjModel* m, int instance, double final_drive, double idle_speed, double pedal_up,
            double reference_torque);

  const ClutchControl& control() const { return control_; }
  double efficiency() const { return efficiency_; }

  // Kinetic and elastic energy of what turns with the engine [J].
  static double Energy(const DrivelineState& s, double engine_speed) {
    return 0.5 * (s.inertia * engine_speed * engine_speed + s.stiffness * s.torsion * s.torsion);
  }

  // Takes over the inertia and the stiffness of the gear that is in.
  void SetGear(const GearData& gear, DrivelineState* s) const;

  // One step of clutch, engine speed and gears; fills `work`. The propeller shaft's torque behind
  // the final drive's losses, work->shaft_torque, is what the wheels get.
  void Step(const GearData& gear, double engine_torque, double retarder_torque, double shaft_speed,
            double h, DrivelineState* s, double* engine_speed, StepWork* work) const;

  // Torque behind a pair of gears. Losses oppose the flow of power, whichever way it goes.
  double AfterLoss(double torque, double speed, double efficiency) const;

 private:
  ClutchControl control_;
  double torque_max_;           // of the closed clutch [N m]
  double efficiency_;           // behind the gearbox
  double stiffness_, damping_;  // at the propeller shaft
  double loss_reversal_speed_;  // over which the loss turns to the other side [rad/s]
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_DRIVELINE_H_
