// From the crankshaft to the propeller shaft: clutch, gears, losses, and the dissipated energies.
#ifndef IITS_MJ_PLUGIN_LAWS_DRIVELINE_H_
#define IITS_MJ_PLUGIN_LAWS_DRIVELINE_H_

#include "plugin/laws/gear_loss.h"
#include "plugin/laws/number.h"

namespace iits {

// One semi-implicit step of engine inertia against clutch and elastic driveline, one torsional
// spring and damper that slips at the clutch's capacity:
//
//   J dw/dt = T_e - T,   T = k x + c dx/dt,   |T| <= capacity   (return mapping)
//
// T contains the engine speed at the end of the step, so that the engine's side is stable at any
// step, and the gearbox speed at its start. In slip, dx/dt follows from |T| = capacity.
template <class T>
struct ElasticClutch {
  T stiffness;  // at the gearbox input [N m/rad]
  T damping;    // at the gearbox input [N m s/rad]

  // Returns the clutch torque, positive from the engine to the wheels; updates torsion and speed.
  T Step(T engine_torque, T inertia, T input_speed, T capacity, T h, T* torsion,
         T* engine_speed) const {
    const T free_speed = *engine_speed + h * engine_torque / inertia;
    const T gain = stiffness * h + damping;
    T torque =
        (stiffness * *torsion + gain * (free_speed - input_speed)) / (1 + gain * h / inertia);
    torque = Clamp(torque, -capacity, capacity);
    *torsion = (h * torque + damping * *torsion) / gain;
    *engine_speed = Max(0.0, free_speed - h * torque / inertia);
    return torque;
  }
};

// Engagement of the clutch, 0 open to 1 closed, by a gearbox controller with a gear engaged.
template <class T>
struct ClutchControl {
  T idle_speed;           // [rad/s]
  T pedal_up;             // accelerator travel up to which the clutch stays open at standstill
  T launch_share;         // engagement that carries the engine's reference torque
  T engagement_time;      // full travel at launch [s]
  T opening_time;         // full travel [s]
  T launch_range;         // engine speed above idle, to the reference torque [rad/s]
  T alike_range;          // speed difference at which the clutch closes completely [rad/s]
  T release_share;        // of idle: gearbox input speed below which it opens, pedal down
  T release_share_coast;  // the same, pedal up
  T stall_share;          // of idle: engine speed at which its capacity is zero
  T stall_range;          // of idle: above, to the whole capacity

  // The clutch slips while the truck starts: its torque increases with the engine speed above idle.
  // So it settles at the engine's torque, cannot stall the engine, and carries nothing at idle. It
  // closes completely when the speeds of both sides are nearly equal, and opens near idle speed.
  T Update(T engagement, T engine_speed, T input_speed, T pedal, T h) const {
    const bool powered = pedal >= pedal_up;
    T target = 0;
    if (input_speed > (powered ? release_share : release_share_coast) * idle_speed) {
      const bool alike = abs(engine_speed - input_speed) < alike_range;
      const T pulled = Max(engine_speed, input_speed);
      target = alike || engagement >= 1 ? T(1) : Launch(pulled);
    } else if (powered) {
      target = Launch(engine_speed);
    }
    return Clamp(target, engagement - h / opening_time, engagement + h / engagement_time);
  }

  // Reduces the capacity to zero before the engine stalls, independently of the control.
  T StallGuard(T engine_speed) const {
    return Clamp((engine_speed / idle_speed - stall_share) / stall_range, 0.0, 1.0);
  }

 private:
  T Launch(T speed) const {
    return Clamp((speed - idle_speed) / launch_range, 0.0, 1.0) * launch_share;
  }
};

// Energies since the reset [J].
template <class T>
struct EnergyAccount {
  T engine_work;     // at the crankshaft, negative in overrun
  T clutch_loss;     // slip, damping, synchronizing
  T gear_loss;       // gears, final drive, drag of the empty retarder
  T retarder_work;   // turned into heat, >= 0
  T auxiliary_work;  // taken from the crankshaft, >= 0
};

template <class T>
struct DrivelineState {
  T torsion;     // at the gearbox input [rad]
  T engagement;  // of the clutch, 0 to 1
  T inertia;     // turning with the crankshaft in the last step [kg m2]
  T stiffness;   // of the last step, at the gearbox input [N m/rad]
};

// Torques of one step. Book adds their work, with the mean of the speeds at start and end of the
// step: h T (w + w') / 2 is exactly the change of the kinetic energy of a constant inertia.
template <class T>
struct StepWork {
  // Of the engine; of the auxiliaries; clutch to gears, less the stored energy.
  T engine_work, auxiliary_work, clutch_work;
  T gear_torque, retarder_torque, shaft_torque;  // at the propeller shaft [N m]
  T shaft_speed;                                 // at the step's start [rad/s]

  void Book(T end_speed, T h, EnergyAccount<T>* account) const {
    const T angle = 0.5 * h * (shaft_speed + end_speed);
    account->engine_work += engine_work;
    account->clutch_loss += clutch_work - angle * gear_torque;
    account->gear_loss += angle * (gear_torque - retarder_torque - shaft_torque);
    account->retarder_work += angle * retarder_torque;
    account->auxiliary_work += auxiliary_work;
  }
};

// Data of the engaged gear for the driveline.
template <class T>
struct GearData {
  T ratio;    // 0: none, negative in reverse
  T inertia;  // with the crankshaft's [kg m2]
  GearLoss<T> loss;
};

// Torques on the driveline [N m]: of the engine, of the auxiliaries on the crankshaft, of the
// retarder, and the drag of the empty retarder.
template <class T>
struct DrivelineTorques {
  T engine, auxiliary, retarder, retarder_drag;
};

template <class T>
struct Driveline {
  ClutchControl<T> control;
  T torque_max;           // of the closed clutch [N m]
  T stiffness, damping;   // at the propeller shaft; attributes give them at the wheels
  T loss_reversal_speed;  // range of speeds in which the loss changes its sign [rad/s]

  // Kinetic and elastic energy of the parts that turn with the engine [J].
  static T Energy(const DrivelineState<T>& s, T engine_speed) {
    return 0.5 * (s.inertia * engine_speed * engine_speed + s.stiffness * s.torsion * s.torsion);
  }

  // Adopts the inertia and the stiffness of the engaged gear.
  void SetGear(const GearData<T>& gear, DrivelineState<T>* s) const {
    s->inertia = gear.inertia;
    if (gear.ratio == 0) {
      s->stiffness = s->torsion = s->engagement = 0;
    } else {
      s->stiffness = stiffness / (gear.ratio * gear.ratio);
    }
  }

  // One step of clutch, engine speed and gears; fills `work`. The propeller shaft's torque behind
  // the final drive's losses, work->shaft_torque, acts on the wheels.
  void Step(const GearData<T>& gear, const GearLoss<T>& axle, const DrivelineTorques<T>& torques,
            T shaft_speed, T h, DrivelineState<T>* s, T* engine_speed, StepWork<T>* work) const {
    const T flywheel_torque = torques.engine - torques.auxiliary;
    const T before = Energy(*s, *engine_speed);
    const T start_speed = *engine_speed;
    SetGear(gear, s);
    const T input_speed = gear.ratio * shaft_speed;
    T clutch_torque = 0;
    if (gear.ratio == 0) {
      *engine_speed = Max(0.0, start_speed + h * flywheel_torque / gear.inertia);
    } else {
      const T capacity = s->engagement * torque_max * control.StallGuard(start_speed);
      const ElasticClutch<T> clutch = {s->stiffness, damping / (gear.ratio * gear.ratio)};
      clutch_torque = clutch.Step(flywheel_torque, gear.inertia, input_speed, capacity, h,
                                  &s->torsion, engine_speed);
    }
    const T turned = start_speed + *engine_speed;
    work->engine_work = 0.5 * h * torques.engine * turned;
    work->auxiliary_work = 0.5 * h * torques.auxiliary * turned;
    // Includes the energy that a gear change takes from the rotating parts or adds to them.
    work->clutch_work =
        work->engine_work - work->auxiliary_work - (Energy(*s, *engine_speed) - before);
    work->gear_torque = clutch_torque * gear.ratio;
    work->retarder_torque = torques.retarder;
    const T turning = gear.ratio < 0 ? -shaft_speed : shaft_speed;
    const T geared =
        gear.loss.After(clutch_torque, input_speed, turning, loss_reversal_speed) * gear.ratio;
    const T drag = Clamp(shaft_speed / loss_reversal_speed, -1.0, 1.0) * torques.retarder_drag;
    work->shaft_torque =
        axle.After(geared - torques.retarder - drag, shaft_speed, shaft_speed, loss_reversal_speed);
    work->shaft_speed = shaft_speed;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_DRIVELINE_H_
