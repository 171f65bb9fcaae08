// Tire plugin `iits.tire`: vertical spring, combined slip with relaxation, rolling resistance.
#ifndef IITS_MJ_PLUGIN_TIRE_H_
#define IITS_MJ_PLUGIN_TIRE_H_

#include <mujoco/mujoco.h>

#include <vector>

#include "plugin/road.h"

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
    int body, hub, dof;
  };
  struct Sensor {
    int address, wheel, first, count;
  };
  struct Slip {
    double sx, sy;      // theoretical slips [1]
    double fx, fy;      // forces [N]
    double saturation;  // normalised slip; full sliding near 3
  };

  Tire() = default;
  void WheelForces(const mjModel* m, mjData* d, const Wheel& wheel, State* s) const;
  Slip Combine(double sx, double sy, double load, double surface) const;

  std::vector<Wheel> wheels_;
  std::vector<Sensor> sensors_;
  Road road_;
  // Attributes, see README.md.
  double count_, free_radius_, rolling_radius_, vertical_stiffness_, vertical_damping_;
  double cornering_coefficient_, pneumatic_trail_, nominal_load_, friction_lateral_;
  double friction_longitudinal_, friction_load_slope_, shape_lateral_, shape_longitudinal_;
  double curvature_lateral_, curvature_longitudinal_, load_saturation_, slip_stiffness_;
  double relaxation_lateral_, relaxation_load_exponent_, relaxation_longitudinal_;
  double rolling_resistance_;
  double nominal_deflection_ = 0;
  double cornering_scale_ = 0;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_TIRE_H_
