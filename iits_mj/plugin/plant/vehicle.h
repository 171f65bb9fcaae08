// The planar plant's description of the truck, and the values of a step; for plant/*.cc only.
#ifndef IITS_MJ_PLUGIN_PLANT_VEHICLE_H_
#define IITS_MJ_PLUGIN_PLANT_VEHICLE_H_

#include <string>
#include <vector>

#include "plugin/plant/plant.h"

namespace iits {

inline constexpr int kNoJoint = -1;

struct Plant::Axle {
  int unit;
  double x, half_track;
  double static_load;  // of the axle on a level road [N]
  double rate;         // of its tires [N/m]; 0 for a lifted axle
  const Tire<double>* law;
  int state[2], spin[2], hub[2];  // addresses of the wheels in plugin_state, qvel; hub's number
  int spin_qpos[2];
  Pair carry;
  double inverse_inertia[2], shaft[2];  // of the spin; torque per torque of the propeller shaft
  bool steered = false;
  int knuckle_qpos[2] = {0, 0}, knuckle[2] = {kNoJoint, kNoJoint};
  double knuckle_inertia = 0, knuckle_damping = 0, knuckle_stiffness = 0, knuckle_max = 0;
  int target = -1;  // place among the axles that the steering's linkage turns
  int roll_qpos = kNoJoint;
  double roll_stiffness, roll_damping, tire_roll_stiffness;  // about the roll center, on the road
  double share;                      // of the spring in series with the tires
  double roll_center, mass, height;  // heights above the road [m]; mass without the sprung one
  double pitch_gain[kUnitsMax];      // load [N] per pitch moment of each unit [N m]
};

struct Plant::Unit {
  int body;
  PlanarInertia<double> inertia;
  double coupling;       // lever c of the front coupling above the roll axis [m]
  double roll_axis;      // height above the road [m]
  double hitch_height;   // of the next unit's coupling above the road [m]
  double front_height;   // of the own coupling, 0 of the first unit [m]
  double pitch_inertia;  // sum of m (z - front_height) [kg m]
  double pitch_product;  // sum of m (z - front_height) x, with the bodies' own [kg m2]
  double sprung_mass, sprung_x, sprung_lever;  // lever: height of its CG above the roll axis [m]
  double tilting;        // roll moment of the weights per roll angle [N m/rad]
  double coupling_load;  // vertical load on the coupling [N]
  int first_axle, end_axle;
  double pole;  // place of the axles' center, which does not move sideways without slip [m]
  // Fifth wheel.
  const FifthWheel<double>* law = nullptr;
  int law_state = 0, yaw_qpos = 0, yaw_dof = 0;
  bool limited = false;
  double yaw_min = 0, yaw_max = 0;
  // Pressure centers.
  struct Air {
    const Aerodynamics<double>* law;
    double x, height;
  };
  std::vector<Air> air;
};

// Intermediate values of a step.
struct Plant::Scratch {
  PlanarMotion<double> motion[kUnitsMax];
  double cosine[kUnitsMax], sine[kUnitsMax], x[kUnitsMax], y[kUnitsMax];
  double shaft_torque, pitman_angle;
  Pair steer[kPlantAxlesMax];  // angles of the knuckles [rad]
  PlanarVector<double> force[kUnitsMax];
  double hitch[kUnitsMax][2];
  double pitch[kUnitsMax];          // moment of each unit about its coupling
  double load[kUnitsMax];           // of the tires
  double slope[kUnitsMax][2];       // of the road's plane, world axes, over the normal
  double air_roll[kUnitsMax];       // moment about the roll axis
  double tilt[kUnitsMax];           // of the road below the axles, left side up [rad]
  double coupling_roll[kUnitsMax];  // moment of the coupling about the unit's own x axis
  double lateral[kPlantAxlesMax], overturning[kPlantAxlesMax];  // of an axle's tires
  int left_range = 0;                                           // bits of Range
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_PLANT_VEHICLE_H_
