// The planar plant: planar motion of a truck in place of MuJoCo's step, on the same mjData.
#ifndef IITS_MJ_PLUGIN_PLANT_PLANT_H_
#define IITS_MJ_PLUGIN_PLANT_PLANT_H_

#include <mujoco/mujoco.h>

#include <string>
#include <vector>

#include "plugin/laws/planar.h"
#include "plugin/parts.h"

namespace iits {

inline constexpr int kPlantAxlesMax = 16;

// State of the plant beside qpos, qvel and plugin_state, the last part of mjData.userdata; all zero
// after a reset, and then it is read from qpos and qvel.
struct PlantState {
  // Lead unit's position and velocity, and what was written to qpos and qvel last: if a user has
  // changed these, the state is read from them again.
  double initialized;  // 1: before the first step, 2: after it
  double x, y, yaw, vx, vy;
  double seen[13 + 6 * kUnitsMax];
  struct Unit {
    double articulation;                // yaw against the unit ahead [rad]
    double yaw_rate;                    // [rad/s]
    double roll, roll_rate;             // of the sprung mass against the road [rad], [rad/s]
    PlanarVector<double> acceleration;  // of the coupling point, at the last step
    double tilt, tilt_rate;             // of the road below the axles, left side up [rad], [rad/s]
    double gravity_x, gravity_y;        // along the unit's axes in the road's plane [m/s2]
    double last_gravity_x;              // of the step before [m/s2]
  } unit[kUnitsMax];
  struct Axle {
    double pitch_load;       // moved onto the axle by pitch [N]
    double roll_moment;      // of the tires' loads about the axle's middle [N m]
    double roll, roll_rate;  // of the axle against the road [rad], [rad/s]
  } axle[kPlantAxlesMax];
  double left_range;  // bits of Range; stays set until the reset
};

// Limits of the model's validity.
enum Range { kWheelLift = 1, kArticulation = 2, kRollAngle = 4, kCrest = 8, kSlip = 16 };

// Motions of the plant: with the units' roll as states, without it, or without slip of the axles.
enum class Motion { kYawSideslip, kYawRoll, kKinematic };

class Plant {
 public:
  // Reads the truck with a name prefix from a model; `error` is not empty if it is not possible.
  Plant(const mjModel* m, const std::string& prefix, Motion motion, std::string* error);
  ~Plant();
  Plant(const Plant&) = delete;
  Plant& operator=(const Plant&) = delete;

  // Advances by `count` time steps and computes the sensors: `observe` with the forces of the new
  // state, otherwise with those of the last step. False if the state is no longer finite.
  bool Step(const mjModel* m, mjData* d, int count, bool observe) const;

 private:
  struct Axle;
  struct Unit;
  struct Scratch;

  bool FindUnits(const mjModel* m, const std::string& prefix, std::string* error);
  bool FindAxles(const mjModel* m, std::string* error);
  bool FindPlugins(const mjModel* m, const std::string& prefix, std::string* error);
  void SolvePitchGains(const mjModel* m);
  void SumInertia(const mjModel* m);
  PlantState* State(const mjModel* m, mjData* d) const;
  void Adopt(const mjModel* m, mjData* d, PlantState* s) const;
  void Publish(const mjModel* m, mjData* d, PlantState* s) const;
  void Remember(const mjModel* m, const mjData* d, double* seen) const;
  template <bool kRolls>
  void Compute(const mjModel* m, mjData* d, PlantState* s, bool commit) const;
  template <bool kRolls>
  void Advance(const mjModel* m, mjData* d, PlantState* s, Scratch* at) const;
  void PlaceUnits(const PlantState& s, Scratch* at) const;
  void Actuate(const mjModel* m, mjData* d, Scratch* at) const;
  void AddTires(const mjModel* m, mjData* d, int u, PlantState* s, Scratch* at) const;
  void MeasureSlope(const mjModel* m, int u, PlantState* s, Scratch* at) const;
  void AddAir(const mjModel* m, int u, Scratch* at) const;
  void AddRoll(double h, int u, PlantState* s, Scratch* at) const;
  void AddCouplings(double h, mjData* d, const PlantState& s, Scratch* at) const;
  void FollowAxles(double h, PlantState* s, Scratch* at) const;
  void MoveLoads(double h, double gravity, const Scratch& at, PlantState* s) const;
  void RollStatically(double h, Scratch* at, PlantState* s) const;

  bool rolls_, kinematic_;
  mjData* own_ = nullptr;  // the plugins' objects
  int lead_qpos_ = 0, lead_dof_ = 0;
  std::vector<Unit> units_;
  std::vector<PlanarInertia<double>> inertia_;  // of the units, in sequence
  int guide_ = -1;                              // axle that the linkage steers first
  std::vector<Axle> axles_;
  RoadTable road_;
  int road_address_ = 0;
  const Steering<double>* steering_ = nullptr;
  int steering_instance_ = -1, powertrain_instance_ = -1, brake_instance_ = -1;
  const mjpPlugin *steering_plugin_ = nullptr, *powertrain_plugin_ = nullptr;
  const mjpPlugin* brake_plugin_ = nullptr;
  int shaft_force_ = -1;  // address in actuator_force
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_PLANT_PLANT_H_
