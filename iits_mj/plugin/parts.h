// The parts of a truck that the planar plant shares with MuJoCo's step: laws and states of the
// plugin instances, so that both have one source of numbers.
#ifndef IITS_MJ_PLUGIN_PARTS_H_
#define IITS_MJ_PLUGIN_PARTS_H_

#include <mujoco/mujoco.h>

#include "plugin/laws/aerodynamics.h"
#include "plugin/laws/fifth_wheel.h"
#include "plugin/laws/road.h"
#include "plugin/laws/steering.h"
#include "plugin/laws/tire.h"

namespace iits {

// State of one wheel: the committed bristles, those of the next step, and the signals of sensors.
struct TireState {
  TireBristles<double> bristles;
  double station;  // hint for the road look-up [m]
  TireBristles<double> next_bristles;
  double next_station;
  double signal[TireForces<Pair>::kSignals];
  double puncture;  // last: lost share of a tire's pressure, set from outside
};

struct FifthWheelState {
  double wind_up, next_wind_up;  // of the plate's friction [rad]
};

struct SteeringStates {
  SteeringState<double> now, next;
};

// Law of the tires of an instance, and the road below them.
struct TirePart {
  const Tire<double>* law;
  RoadTable road;
  int road_address;  // in numeric_data
};

// Each takes an instance of its plugin in data of the model.
TirePart TireOf(const mjData* d, int instance);
const FifthWheel<double>* FifthWheelOf(const mjData* d, int instance);
const Steering<double>* SteeringOf(const mjData* d, int instance);
const Aerodynamics<double>* AerodynamicsOf(const mjData* d, int instance);
// Computes the next pressures, with the forward speeds of the hubs in the order of the instance.
void ActuateAirBrake(const mjModel* m, mjData* d, int instance, const double* hub_speeds);

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_PARTS_H_
