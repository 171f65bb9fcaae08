// Electronic brake control: from XBR demand and brake pedal to the supply pressure of each circuit
// and to the torque that the endurance brakes are asked for.
#ifndef IITS_MJ_PLUGIN_BRAKE_CONTROL_H_
#define IITS_MJ_PLUGIN_BRAKE_CONTROL_H_

#include <mujoco/mujoco.h>

#include "plugin/brake_distribution.h"
#include "plugin/dead_time.h"

namespace iits {

// What the controller remembers between steps.
struct BrakeControlState {
  double initialized;
  double supply[kCircuits];  // pressure at the outlet of the supply valve [Pa]
  // A model of the brakes behind it: pressure in the chambers, what their hysteresis makes of that
  // [Pa], and the share of the hysteresis by which the supply is lowered to make up for it.
  double chamber[kCircuits], effective[kCircuits], lowering[kCircuits];
  double speed;         // of the vehicle, low-passed [m/s]
  double reference[2];  // demand as the brakes can follow it, then as the filter shows it [m/s2]
  double xbr;           // XBR demand that is followed: it falls gradually [m/s2]
  double trim;          // added to the demand by the deceleration control [m/s2]
  double shaft, shaft_max;  // force of the propeller shaft now, and what the propeller shaft could
                            // do; low-passed [N]
  double asked;             // of the propeller shaft [N]
  double holding;           // 1: the brakes hold the standing vehicle
  double hold_time;         // since the demand ended, while holding [s]
};

struct BrakeDemand {
  enum XbrMode { kOff = 0, kAddition, kMaximum };                    // SPN 2916
  enum EbiMode { kFrictionOnly = 0, kEnduranceOnly, kIntegration };  // SPN 2914
  double xbr;    // demanded deceleration, >= 0, 0 when XBR is off [m/s2]
  double pedal;  // of the driver, 0 to 1
  XbrMode xbr_mode;
  EbiMode ebi_mode;
  bool abs_active;  // on any wheel
  bool abs_on_drive;
  double speed;             // of the vehicle, forward [m/s]
  double mass, gravity;     // of the whole vehicle [kg]; [m/s2]
  double shaft_force;       // that the propeller shaft brakes the vehicle with now, signed [N]
  double shaft_force_max;   // what it could [N]
  double uphill_torque;     // brake torque that keeps the vehicle from rolling back [N m]
  const double* reservoir;  // pressure of each circuit's [Pa]
};

// What the control asks of others.
struct BrakeEffort {
  double shaft_force;  // braking force wanted of the propeller shaft, >= 0 [N]
  bool active;         // somebody asks for braking
};

class BrakeControl {
 public:
  bool Read(const mjModel* m, int instance);  // false after a warning
  // A wheel of this circuit, radius [m], spin inertia [kg m2], torque per pressure [N m/Pa].
  void AddWheel(int circuit, double radius, double inertia, double torque_per_pressure);
  // From the supply valve to the brake, mean [s].
  void set_response_time(double time) { response_time_ = time; }

  // Advances the supply pressures by h.
  BrakeEffort Update(const BrakeDemand& demand, double h, BrakeControlState* s) const;

 private:
  struct Level {  // of what is asked [m/s2]
    double driver, total;
  };
  struct Targets {
    double pressure[kCircuits];
    BrakeEffort effort;
    bool limited;  // the brakes cannot give more
    bool idle;     // the brakes cannot give less
  };
  Level Arbitrate(const BrakeDemand& demand, double h, BrakeControlState* s) const;
  void Hold(const BrakeDemand& demand, bool active, double h, BrakeControlState* s) const;
  double ShaftForce(const BrakeDemand& demand, double h, BrakeControlState* s) const;
  Targets Blend(const BrakeDemand& demand, const Level& level, double shaft_force,
                const BrakeControlState& s) const;
  void Trim(const BrakeDemand& demand, double wanted, double deceleration, const Targets& targets,
            double supplied, double h, BrakeControlState* s) const;
  double Force(const BrakeDemand& demand, double deceleration) const;
  void Supply(int circuit, double wanted, double h, BrakeControlState* s) const;

  BrakeDistribution distribution_;
  double rise_rate_, fall_rate_, pressure_max_, release_rate_;
  double pedal_deceleration_, rolling_resistance_;
  double filter_time_, trim_gain_, trim_max_, trim_share_, trim_speed_min_;
  double shaft_speed_off_, shaft_speed_on_, endurance_rate_;
  double push_out_, hysteresis_, hysteresis_time_;
  double hold_speed_, hold_deceleration_, hold_release_speed_, hold_time_max_, hold_uphill_;
  double response_time_ = 0, spin_mass_ = 0, radius_sum_ = 0;
  int wheels_ = 0;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_BRAKE_CONTROL_H_
