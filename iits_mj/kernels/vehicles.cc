// Vehicles of the traffic: poses from places on SUMO's lanes, and which vehicles are near.
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "kernels/kernels.h"
#include "kernels/vehicle_columns.h"

using namespace iits;

namespace {

constexpr double kTurn = 6.283185307179586;

// A piece of a lane: four coefficients of x, y and z, then start and change of station, offset,
// heading, pitch, roll and curvature.
constexpr int kPiece = 24;
constexpr int kLinear[] = {kStation, kOffset, kYaw, kPitch, kRoll};
constexpr int kCurvature = 5;

}  // namespace

// Writes the rows from x to offset of n vehicles on their lanes' centers.
//
//   lanes: first piece, last piece, direction on the route and pieces per meter, shape (4, n).
//   pieces: of all lanes, shape (count, kPiece).
//   given: speed and position of the front bumper on the lane, shape (2, n).
//   center: positions of the vehicles' centers [m], shape (n,). With `placed` they are given, else
//     they are computed; if some lie before the beginning of their lane, nothing else is computed.
//   step: since the last call, for the acceleration from the speed's row; 0 keeps that row [s].
//
// Returns the number of centers before the beginning of their lane; 0 with `placed`.
IITS_KERNEL std::ptrdiff_t iits_vehicles_on_lanes(std::ptrdiff_t n, const double* lanes,
                                                  const double* pieces, const double* given,
                                                  double* center, std::ptrdiff_t placed,
                                                  double step, double* columns) {
  const double *speed = given, *position = given + n;
  if (!placed) {
    std::ptrdiff_t before = 0;
    for (std::ptrdiff_t k = 0; k < n; ++k) {
      center[k] = position[k] - 0.5 * columns[kLength * n + k];
      before += center[k] < 0.0;
    }
    if (before) return before;
  }
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double first = lanes[k], last = lanes[n + k], direction = lanes[2 * n + k];
    const double scale = lanes[3 * n + k];
    const double place = center[k] * scale;
    const double piece = std::min(std::trunc(std::max(place, 0.0)), last);
    const double inside = place - piece;
    const double t = std::min(std::max(inside, 0.0), 1.0);
    const double beyond = inside - t;
    const double* c = pieces + static_cast<std::ptrdiff_t>(first + piece) * kPiece;
    double* row = columns + k;
    for (int axis = 0; axis < 3; ++axis) {
      const double c0 = c[axis], c1 = c[3 + axis], c2 = c[6 + axis], c3 = c[9 + axis];
      row[axis * n] = c0 + t * (c1 + t * (c2 + t * c3));
      if (beyond != 0.0) row[axis * n] += beyond * (c1 + t * (2.0 * c2 + 3.0 * t * c3));
    }
    for (int i = 0; i < kCurvature; ++i) row[kLinear[i] * n] = c[12 + i] + t * c[18 + i];
    if (beyond != 0.0) row[kStation * n] += direction * beyond / scale;
    row[kYawRate * n] = (c[12 + kCurvature] + t * c[18 + kCurvature]) * speed[k];
    if (step > 0.0) row[kAcceleration * n] = (speed[k] - row[kSpeed * n]) / step;
    row[kSpeed * n] = speed[k];
    row[kLateralSpeed * n] = 0.0;
  }
  return 0;
}

// Turns the yaw of n vehicles into -pi to pi, and finds the vehicles near a point.
//
//   reach: square of the distance [m2].
//   near: 1.0 for a vehicle within it, else 0.0, shape (n,).
//
// Returns the number of vehicles within it.
IITS_KERNEL std::ptrdiff_t iits_vehicles_in_view(std::ptrdiff_t n, double* columns, double x,
                                                 double y, double reach, double* near) {
  std::ptrdiff_t count = 0;
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    double& yaw = columns[kYaw * n + k];
    yaw = yaw - kTurn * std::rint(yaw / kTurn);
    const double dx = columns[kX * n + k] - x, dy = columns[kY * n + k] - y;
    near[k] = dx * dx + dy * dy <= reach;
    count += near[k] != 0.0;
  }
  return count;
}

// Finds the vehicles whose sides a vehicle overlaps now, and no longer after its lane change.
//
//   boxes: station, offset, direction on the route, length and width of n boxes, shape (5, n).
//   own: number of the vehicle.
//   aim: its offset after the change [m].
//   reach, sideways: distances within which others count, along and across [m].
//   margin: between two sides [m].
//   found: numbers of these vehicles, shape (n,).
//
// Returns how many they are.
IITS_KERNEL std::ptrdiff_t iits_vehicles_beside(std::ptrdiff_t n, const double* boxes,
                                                std::ptrdiff_t own, double aim, double reach,
                                                double sideways, double margin, double* found) {
  const double *station = boxes, *offset = boxes + n, *direction = boxes + 2 * n;
  const double* width = boxes + 4 * n;
  std::ptrdiff_t count = 0;
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double aside = std::fabs(offset[k] - offset[own]);
    if (k == own || direction[k] == 0.0 || !(aside < sideways)) continue;
    if (!(std::fabs(station[k] - station[own]) < reach)) continue;
    const double side = 0.5 * (width[k] + width[own]) + margin;
    if (aside < side && side <= std::fabs(offset[k] - aim)) found[count++] = k;
  }
  return count;
}
