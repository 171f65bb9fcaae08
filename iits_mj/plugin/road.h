// The road surface under the tires: a table of the route's reference line, or a flat plane.
//
// The table is a custom numeric of the model named `iits_road` (any prefix of an attached model is
// accepted), so that it lives in mjModel and costs nothing per mjData:
//   version, row count, station of row 0 [m], step [m], then rows of 11 numbers:
//   x, y, z [m], cos(heading), sin(heading), curvature [1/m], grade [1], tan(superelevation),
//   friction left, friction right, offset of the friction split [m].
// Height is C1: cubic Hermite in station, linear across the road.
#ifndef IITS_MJ_PLUGIN_ROAD_H_
#define IITS_MJ_PLUGIN_ROAD_H_

#include <mujoco/mujoco.h>

#include "plugin/pair.h"

namespace iits {

// The surface at two points.
struct RoadPoints {
  Pair height;    // [m], at the point asked for
  Pair up[3];     // along the normal, world frame, with up[2] = 1
  Pair norm;      // makes it the unit normal
  Pair friction;  // of the surface
  Pair station;   // [m], also the hint for the next call
};

class Road {
 public:
  // Binds to the model's table; false (after a warning) when there is one that is not valid.
  bool Bind(const mjModel* m, int instance);

  // Surface under two points (x, y). `station_hint` < -1e9 means unknown. Pure function of its
  // arguments wherever the road does not pass over itself.
  RoadPoints Evaluate(const mjModel* m, Pair x, Pair y, Pair station_hint) const;

  static constexpr double kUnknownStation = -1e10;

 private:
  int FindRow(const double* rows, double x, double y, double station_hint) const;

  int address_ = -1;
  int count_ = 0;
  double start_ = 0;
  double step_ = 1;
  double inverse_step_ = 1;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_ROAD_H_
