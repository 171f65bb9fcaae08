// The whole powertrain: engine, clutch, automated gearbox, retarder, driveline to the wheels.
#ifndef IITS_MJ_PLUGIN_LAWS_POWERTRAIN_H_
#define IITS_MJ_PLUGIN_LAWS_POWERTRAIN_H_

#include "plugin/laws/driveline.h"
#include "plugin/laws/endurance.h"
#include "plugin/laws/engine.h"
#include "plugin/laws/gearbox.h"
#include "plugin/laws/retarder.h"

namespace iits {

// Complete state; zero after a reset, and then the first step chooses a gear (`initialized`).
template <class T>
struct PowertrainCore {
  T initialized;
  EngineState<T> engine;
  GearboxState<T> gearbox;
  DrivelineState<T> driveline;
  RetarderState<T> retarder;
  T held_back;        // part of the accelerator that the brakes cut, 0 to 1
  T shaft_torque;     // behind all losses [N m]
  T retarder_torque;  // at the retarder, >= 0 [N m]
  T fuel_used;        // since the reset [kg]
  EnergyAccount<T> energy;
};

// Values for sensors, one number per signal; sums are those before the step.
template <class T>
struct PowertrainOutput {
  T gear, shift_in_process, engine_speed, engine_torque;
  T engine_torque_percent, torque_loss_percent;
  // As one sensor, these five are `powertrain_report`.
  T gear_engaged, input_shaft_speed;
  T engine_torque_mode, engine_torque_percent_driver, engine_load_percent;
  T fuel_rate, fuel_used, clutch_engagement;
  T propeller_shaft_torque, propeller_shaft_speed, accelerator_pedal_position;
  T engine_brake_torque, engine_brake_torque_percent, engine_brake_torque_percent_intended;
  T engine_brake_torque_percent_available;
  T retarder_torque, retarder_torque_percent, retarder_torque_percent_intended;
  T retarder_torque_percent_available, retarder_heat;
  T engine_work, driveline_loss, clutch_loss, retarder_work, driveline_energy, auxiliary_work;
};

template <class T>
struct PowertrainState {
  EnduranceState<T> endurance;  // first: the brake control reads it
  PowertrainCore<T> now, next;
  EnduranceState<T> next_endurance;
  StepWork<T> work;  // of the step that leads to `next`
  T next_is_fresh;   // a step was computed since the last commit
  PowertrainOutput<T> output;

  // Commits the step that was computed last, with the propeller shaft's speed at its end.
  void Commit(T end_speed, T h) {
    if (next_is_fresh == 0) return;
    now = next;
    work.Book(end_speed, h, &now.energy);
    endurance = next_endurance;
    next_is_fresh = 0;
  }
};

template <class T>
struct PowertrainControls {
  EnduranceLevers<T> levers;
  typename GearboxInput<T>::Mode mode;
  EnduranceDemand<T> demand;
  T mass;              // of the vehicle [kg]
  int requested_gear;  // 1 to n, 0 for an automatic choice
};

template <class T>
struct Powertrain {
  using Core = PowertrainCore<T>;
  using Box = Gearbox<T>;
  using Request = EngineRequest<T>;

  Engine<T> engine;
  Gearbox<T> gearbox;
  Driveline<T> driveline;
  Retarder<T> retarder;
  EnduranceControl<T> endurance;

  // Computes the step of h from s->now to s->next, with the propeller shaft's speed at its start.
  // The torque on the shaft is s->next.shaft_torque.
  void Step(const PowertrainControls<T>& controls, T shaft_speed, T h,
            PowertrainState<T>* s) const {
    s->next = s->now;
    Core* core = &s->next;
    if (core->initialized == 0) Initialize(shaft_speed, core);
    const EnginePoint<T> at = engine.At(core->engine.speed);
    ReportStart(*core, &s->output);
    const T retarder_max = retarder.Available(shaft_speed, core->retarder.heat);
    const T drag = at.drag + at.auxiliary;
    const EnduranceGearing<T> before = Gearing(*core, shaft_speed, drag + at.brake_max);
    const EnduranceCommand<T> command =
        endurance.Update(controls.levers, controls.demand, before, drag, at.brake_max, retarder_max,
                         h, &core->held_back);

    const GearboxInput<T> input = {controls.mode,
                                   command.pedal,
                                   command.engine_brake,
                                   shaft_speed,
                                   core->shaft_torque,
                                   core->engine,
                                   core->driveline.engagement <= 0,
                                   controls.mass,
                                   controls.levers.pedal,
                                   controls.levers.engine_brake,
                                   controls.requested_gear};
    gearbox.Update(engine, input, h, &core->gearbox);
    Request request = gearbox.Request(engine, input, core->gearbox);
    request.limited = core->held_back > 0;
    // Nearly always the engine's pedal is the driver's: one look-up in the map serves both.
    const T pedal = controls.levers.pedal;
    const T driver_torque = engine.PedalTorque(at, pedal);
    request.torque = request.pedal == pedal ? driver_torque : engine.PedalTorque(at, request.pedal);
    if (core->driveline.engagement < 1) request.engine_brake = 0;
    if (controls.demand.drag_relief > 0) {
      request.relieved = true;
      const T pull = endurance.PullTorque(controls.demand, drag) + at.auxiliary;
      request.torque = Max(request.torque, pull);
    }
    engine.Update(request, at, h, &core->engine);

    const GearData<T> gear = Gear(core->gearbox);
    if (gear.ratio != 0) {
      core->driveline.engagement =
          Engagement(*core, request, command.pedal, gear.ratio * shaft_speed, h);
    }
    core->retarder_torque =
        retarder.Update(command.retarder_torque, retarder_max, shaft_speed, h, &core->retarder);
    const DrivelineTorques<T> torques = {engine.BrakeTorque(at, core->engine), at.auxiliary,
                                         core->retarder_torque,
                                         gearbox.gears.RetarderDrag(shaft_speed)};
    driveline.Step(gear, gearbox.gears.AxleLoss(), torques, shaft_speed, h, &core->driveline,
                   &core->engine.speed, &s->work);
    core->shaft_torque = s->work.shaft_torque;

    ReportStep(controls, at, request, command, retarder_max, driver_torque, s);
    core->fuel_used += h * s->output.fuel_rate;
    const EnduranceGearing<T> after = Gearing(*core, shaft_speed, drag + at.brake_max);
    s->next_endurance = {core->gearbox.gear < 0 ? core->shaft_torque : -core->shaft_torque,
                         after.engine_factor * (drag + at.brake_max) +
                             after.retarder_factor * retarder_max + after.loss,
                         core->engine.speed};
    s->next_is_fresh = 1;
  }

 private:
  // Controllers of the engine's torque (SPN 899).
  enum TorqueMode {
    kNoRequest = 0,
    kAccelerator = 1,
    kTraction = 5,
    kTransmission = 6,
    kDragControl = 7,
    kBrakes = 10
  };

  // While a change synchronizes, the gearbox's input turns with the engine, as in the target gear.
  GearData<T> Gear(const GearboxState<T>& s) const {
    const int gear = gearbox.gears.Gear(s.gear);
    const int turning = gear ? gear : gearbox.gears.Gear(s.target);
    return {gearbox.gears.Ratio(gear), engine.inertia + gearbox.gears.InputInertia(turning),
            gearbox.gears.Loss(turning)};
  }

  // Without a closed clutch the engine's factor is zero, so that the retarder fills in time.
  // `engine_max` is the greatest braking torque of engine and auxiliaries.
  EnduranceGearing<T> Gearing(const Core& core, T shaft_speed, T engine_max) const {
    using Line = typename GearLoss<T>::BrakingLine;
    const Gears<T>& gears = gearbox.gears;
    const bool closed = core.gearbox.phase == Box::kInGear && core.driveline.engagement >= 1;
    const int gear = gears.Gear(core.gearbox.gear);
    const T ratio = closed ? T(abs(gears.Ratio(gear))) : T(0);
    const T speed = abs(shaft_speed), drag = gears.RetarderDrag(speed);
    const Line front = gears.Loss(gear).Braking(engine_max, ratio * speed);
    const Line axle = gears.AxleLoss().Braking(ratio * engine_max + drag, speed);
    const T behind = 1 / axle.efficiency;
    const T loss = axle.loss + behind * (drag + ratio * front.loss);
    const T share = Min(1.0, speed / driveline.loss_reversal_speed);
    return {ratio * behind / front.efficiency, behind, share * loss};
  }

  // A vehicle with an initial speed starts in the gear for it, clutch closed, without torque.
  void Initialize(T shaft_speed, Core* core) const {
    *core = Core();
    core->initialized = 1;
    const int gear = gearbox.GearForSpeed(engine, shaft_speed);
    const T input_speed = gearbox.gears.Ratio(gear) * shaft_speed;
    const bool rolling = input_speed > driveline.control.release_share_coast * engine.idle_speed;
    core->engine.speed = rolling ? Min(input_speed, engine.brake_speed) : engine.idle_speed;
    EngineState<T>& s = core->engine;
    s.torque = s.boost_demand = s.boost = engine.drag(s.speed) + engine.Auxiliary(s.speed);
    core->gearbox.gear = core->gearbox.target = gear;
    core->gearbox.gear_time = 0;
    core->gearbox.shaft_speed = shaft_speed;
    driveline.SetGear(Gear(core->gearbox), &core->driveline);
    core->driveline.engagement = rolling ? 1 : 0;
  }

  // Engagement of the clutch, by the phase of a gear change or by the clutch's own control.
  T Engagement(const Core& core, const Request& request, T pedal, T input_speed, T h) const {
    const T engagement = core.driveline.engagement;
    const GearboxState<T>& s = core.gearbox;
    if (s.phase == Box::kCut) {
      // Opens with the torque, so that a slipping clutch does not reduce the engine speed.
      return engagement - engagement * Min(1.0, h / Max(request.time_left, h));
    }
    if (s.phase == Box::kClose) return Min(1.0, s.phase_time / gearbox.close_time);
    if (s.phase != Box::kInGear) return engagement;
    return driveline.control.Update(engagement, core.engine.speed, input_speed, pedal, h);
  }

  // Sums are those before the step, as positions and speeds.
  static void ReportStart(const Core& core, PowertrainOutput<T>* o) {
    o->fuel_used = core.fuel_used;
    o->retarder_heat = core.retarder.heat;
    o->engine_work = core.energy.engine_work;
    o->clutch_loss = core.energy.clutch_loss;
    o->driveline_loss = core.energy.clutch_loss + core.energy.gear_loss;
    o->retarder_work = core.energy.retarder_work;
    o->auxiliary_work = core.energy.auxiliary_work;
    o->driveline_energy = Driveline<T>::Energy(core.driveline, core.engine.speed);
  }

  // Percent torques as in J1939: of the reference torque of engine, engine brake or retarder;
  // braking is negative.
  void ReportStep(const PowertrainControls<T>& controls, const EnginePoint<T>& at,
                  const Request& request, const EnduranceCommand<T>& command, T retarder_max,
                  T driver_torque, PowertrainState<T>* s) const {
    const T pedal = controls.levers.pedal;
    const Core& core = s->next;
    PowertrainOutput<T>* o = &s->output;
    const T of_reference = 100 / engine.reference_torque;
    const T rated = engine.RatedBrakeTorque();
    const T of_engine_brake = rated > 0 ? -100 / rated : T(0);
    const T of_retarder = retarder.torque_max > 0 ? -100 / retarder.torque_max : T(0);
    o->gear = core.gearbox.target;
    o->shift_in_process = core.gearbox.phase != Box::kInGear;
    o->engine_speed = at.speed;
    o->engine_torque = engine.BrakeTorque(at, core.engine);
    o->engine_torque_percent = of_reference * core.engine.torque;
    o->torque_loss_percent = of_reference * at.drag;
    o->engine_torque_percent_driver = of_reference * (driver_torque + at.drag);
    const T greatest = at.limit + at.drag;
    o->engine_load_percent = greatest > 0 ? 100 * Min(1.0, core.engine.torque / greatest) : T(0);
    o->engine_torque_mode = request.mode != request.kPedal   ? kTransmission
                            : request.torque > driver_torque ? kDragControl
                            : request.pedal < pedal && controls.demand.traction_cut != 0 ? kTraction
                            : request.pedal < pedal                                      ? kBrakes
                            : pedal > 0 ? kAccelerator
                                        : kNoRequest;
    o->fuel_rate = engine.FuelRate(at, core.engine);
    o->clutch_engagement = core.driveline.engagement;
    o->propeller_shaft_torque = core.shaft_torque;
    o->propeller_shaft_speed = s->work.shaft_speed;
    o->accelerator_pedal_position = pedal;
    o->engine_brake_torque = core.engine.brake_torque;
    o->engine_brake_torque_percent = of_engine_brake * core.engine.brake_torque;
    o->engine_brake_torque_percent_intended = of_engine_brake * command.engine_brake * at.brake_max;
    o->engine_brake_torque_percent_available = of_engine_brake * at.brake_max;
    o->retarder_torque = core.retarder_torque;
    o->retarder_torque_percent = of_retarder * core.retarder_torque;
    o->retarder_torque_percent_intended = of_retarder * command.retarder_torque;
    o->retarder_torque_percent_available = of_retarder * retarder_max;
    // Without a gear, the gearbox input turns with the engine, and the current gear is the last one
    // engaged (SPN 523).
    const int gear = gearbox.gears.Gear(core.gearbox.gear);
    if (gear != 0 || core.gearbox.phase == Box::kInGear) o->gear_engaged = gear;
    o->input_shaft_speed = gear ? gearbox.gears.Ratio(gear) * s->work.shaft_speed : o->engine_speed;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_POWERTRAIN_H_
