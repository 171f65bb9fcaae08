// Place and readings of an articulated truck, from arrays that `mj_forward` has computed.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "kernels/kernels.h"
#include "kernels/reference_line.h"

namespace {

// `_Sources` of iits_mj/truck/state.py.
struct Sources {
  const double* position;  // of the steer axle's center, world frame [m]
  const double* axes;      // of the tractor, 3 x 3, columns forward, left, up
  const double* trailer;   // position of the trailer's axle group [m]
  const double* gravity;   // world frame [m/s2]
  const double* line;      // table of the road's reference line
  const double* sensors;
  const int64_t* readings;  // indices of sensors
  int64_t count;            // of readings
};

bool Locate(const iits::Line& line, const double* position, double near, double* found) {
  return line.Locate(position[0], position[1], near, found, found + 1) &&
         std::abs(found[1]) < iits::kLost;
}

}  // namespace

// Writes x, y, z, yaw, pitch, roll; gravity forward and to the left in the tractor's frame; station
// and offset of the steer axle and of the trailer's axle group; the readings. Both units are
// searched near a station; returns 0 if one was not found there.
IITS_KERNEL long iits_truck_state(const Sources* from, double near, double trailer_near,
                                  double* row) {
  const double *axes = from->axes, *gravity = from->gravity;
  std::copy(from->position, from->position + 3, row);
  row[3] = std::atan2(axes[3], axes[0]);
  row[4] = -std::asin(std::max(-1.0, std::min(1.0, axes[6])));
  row[5] = std::atan2(axes[7], axes[8]);
  for (int i = 0; i < 2; ++i) {
    row[6 + i] = axes[i] * gravity[0] + axes[3 + i] * gravity[1] + axes[6 + i] * gravity[2];
  }
  const iits::Line line(from->line);
  const bool found = Locate(line, from->position, near, row + 8) &&
                     Locate(line, from->trailer, trailer_near, row + 10);
  for (int64_t i = 0; i < from->count; ++i) row[12 + i] = from->sensors[from->readings[i]];
  return found;
}
