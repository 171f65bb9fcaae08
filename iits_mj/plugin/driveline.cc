#include "plugin/driveline.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "plugin/config.h"

namespace iits {

bool Driveline::Read(const mjModel* m, int instance, double final_drive, double idle_speed,
                     double pedal_up, double reference_torque) {
  ClutchControl& c = control_;
  const Attribute attributes[] = {
      {"clutch_torque_max", 1, 1e6, &torque_max_},
      {"clutch_engagement_time", 0.01, 10, &c.engagement_time},
      {"clutch_opening_time", 0.01, 10, &c.opening_time},
      {"clutch_launch_range", 0.1, 1000, &c.launch_range},
      {"clutch_alike_range", 0, 1000, &c.alike_range},
      {"clutch_release_share", 0, 2, &c.release_share},
      {"clutch_release_share_coast", 0, 2, &c.release_share_coast},
      {"clutch_stall_share", 0, 1, &c.stall_share},
      {"clutch_stall_range", 0.001, 1, &c.stall_range},
      {"driveline_efficiency", 0.5, 1, &efficiency_},
      {"driveline_stiffness", 1, 1e9, &stiffness_},
      {"driveline_damping", 1, 1e9, &damping_},
      {"loss_reversal_speed", 1e-3, 100, &loss_reversal_speed_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  c.idle_speed = idle_speed;
  c.pedal_up = pedal_up;
  c.launch_share = std::min(1.0, reference_torque / torque_max_);
  // Given at the wheels.
  stiffness_ /= final_drive * final_drive;
  damping_ /= final_drive * final_drive;
  return true;
}

double Driveline::AfterLoss(double torque, double speed, double efficiency) const {
  if (torque * speed >= 0) return torque * efficiency;
  const double back = std::min(1.0, std::abs(speed) / loss_reversal_speed_);
  return torque * (efficiency + back * (1 / efficiency - efficiency));
}

void Driveline::SetGear(const GearData& gear, DrivelineState* s) const {
  s->inertia = gear.inertia;
  if (gear.ratio == 0) {
    s->stiffness = s->torsion = s->engagement = 0;
  } else {
    s->stiffness = stiffness_ / (gear.ratio * gear.ratio);
  }
}

void Driveline::Step(const GearData& gear, double engine_torque, double retarder_torque,
                     double shaft_speed, double h, DrivelineState* s, double* engine_speed,
                     StepWork* work) const {
  const double before = Energy(*s, *engine_speed);
  const double start_speed = *engine_speed;
  SetGear(gear, s);
  const double input_speed = gear.ratio * shaft_speed;
  double clutch_torque = 0;
  if (gear.ratio == 0) {
    *engine_speed = std::max(0.0, start_speed + h * engine_torque / gear.inertia);
  } else {
    const double capacity = s->engagement * torque_max_ * control_.StallGuard(start_speed);
    const ElasticClutch clutch = {s->stiffness, damping_ / (gear.ratio * gear.ratio)};
    clutch_torque = clutch.Step(engine_torque, gear.inertia, input_speed, capacity, h, &s->torsion,
                                engine_speed);
  }
  work->engine_work = 0.5 * h * engine_torque * (start_speed + *engine_speed);
  // Also what a change of gear takes from the rotating parts, or gives to them.
  work->clutch_work = work->engine_work - (Energy(*s, *engine_speed) - before);
  work->gear_torque = clutch_torque * gear.ratio;
  work->retarder_torque = retarder_torque;
  const double behind_gears =
      AfterLoss(clutch_torque, input_speed, gear.efficiency) * gear.ratio - retarder_torque;
  work->shaft_torque = AfterLoss(behind_gears, shaft_speed, efficiency_);
  work->shaft_speed = shaft_speed;
}

}  // namespace iits
