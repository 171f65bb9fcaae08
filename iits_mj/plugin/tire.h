// Tire plugin `iits.tire`: vertical spring, combined slip with relaxation, rolling resistance.
#ifndef IITS_MJ_PLUGIN_TIRE_H_
#define IITS_MJ_PLUGIN_TIRE_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "plugin/pair.h"
#include "plugin/road.h"
#include "plugin/sampled.h"
#include "plugin/spatial.h"

namespace iits {

// Constants of one kind of tire; everything that evolves is in plugin_state.
class Tire {
 public:
  static constexpr int kSignals = 8;
  // State of one wheel: the committed bristles, their candidates, and what sensors read.
  struct State {
    double bristle_x, bristle_y;  // relaxation-length deflections [m]
    double bristle_spin;          // rolling-resistance wind-up [rad]
    double station;               // hint for the road look-up [m]
    double next_bristle_x, next_bristle_y, next_bristle_spin, next_station;
    double signal[kSignals];  // Fx, Fy, Fz [N], Mz [N m], slip [1], slip angle [rad], deflection
                              // [m], friction [1]
  };
  static constexpr int kStateSize = sizeof(State) / sizeof(mjtNum);

  static Tire* Create(const mjModel* m, int instance);  // null after a warning
  static int StateSize(const mjModel* m, int instance);

  void Reset(mjtNum* plugin_state) const;
  void Passive(const mjModel* m, mjData* d, int instance) const;
  void Sensors(const mjModel* m, mjData* d, int instance) const;
  void Advance(const mjModel* m, mjData* d, int instance) const;

 private:
  struct Wheel {
    int body, hub, root, dof;
    double carry;  // load over the longitudinal relaxation length that a step can carry [N s2/m]
  };
  struct Sensor {
    int address, wheel;
  };
  // How two wheels meet the road: geometry in world axes, velocities of the patch over the road.
  struct Contact {
    PairMask stands;                  // on the road, else in the air
    Pair arm[3];                      // to the center from the tree's center of mass
    Pair ex[3], ey[3], normal[3];     // unit: ahead, to the left, up
    Pair distance, deflection, load;  // [m], [m], [N]; load 1 in the air
    Pair spin, rolling_radius;        // [rad/s], [m]
    Pair speed, slip_vx, slip_vy;     // [m/s]
    Pair friction, station;
  };
  struct Slip {
    Pair fx, fy;      // forces [N]
    Pair saturation;  // normalised slip; full sliding near 3
    Pair cornering;   // cornering stiffness over load [1/rad]
  };

  Tire() = default;
  void Prepare();
  double ShareX(double rho) const;
  double ShareY(double rho) const;
  double InverseRelaxation(double relative) const;
  Pair InverseRelaxation(Pair relative) const;
  Pair SlipAngle(Pair tangent) const;
  Slip Combine(Pair sx, Pair sy, Pair load, Pair relative, Pair surface) const;
  Contact Meet(const mjModel* m, const mjData* d, const Wheel& a, const Wheel& b,
               Pair station_hint) const;
  void PairForces(const mjModel* m, const mjData* d, const Wheel& a, const Wheel& b, State* sa,
                  State* sb, Wrench wrenches[2]) const;

  std::vector<Wheel> wheels_;
  int common_dof_ = -1;  // last degree of freedom that moves all wheels
  std::vector<Sensor> force_sensors_, slip_sensors_;
  Road road_;
  // Attributes, see README.md.
  double count_, free_radius_, rolling_radius_, vertical_stiffness_, vertical_damping_;
  double cornering_coefficient_, pneumatic_trail_, nominal_load_, friction_lateral_;
  double friction_longitudinal_, friction_load_slope_, shape_lateral_, shape_longitudinal_;
  double curvature_lateral_, curvature_longitudinal_, load_saturation_, slip_stiffness_;
  double relaxation_lateral_, relaxation_load_exponent_, relaxation_longitudinal_;
  double rolling_resistance_;
  // Derived from them.
  double nominal_deflection_, inverse_nominal_load_, inverse_saturation_, inverse_relaxation_x_;
  double inverse_friction_x_, inverse_friction_y_, stiffness_y_;
  Sampled share_x_, share_y_;     // over normalised slip
  Sampled inverse_relaxation_y_;  // over relative load [1/m]
  Sampled angle_;                 // over its tangent
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_TIRE_H_
