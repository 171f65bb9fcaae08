// The trajectory in the map frame: lane path plus quintic over station, on the road's surface.
#include <algorithm>
#include <cmath>

#include "kernels/interpolation.h"
#include "kernels/kernels.h"
#include "kernels/reference_line.h"

using iits::Abscissae;
using iits::Cubic;
using iits::Line;

namespace {

constexpr double kHalfTurn = 0.5 * iits::kTurn;
// Shorter pieces of the plan have no direction of their own [m].
constexpr double kMoves = 0.02;

// Polynomial q(s) from `start` on over `length`: constant before it, zero after it.
struct Quintic {
  double start, length, square, a0, a1, a2, a3, a4, a5;

  void Add(double station, double* value, double* slope, double* bend) const {
    double t = (station - start) / length;
    t = std::min(std::max(t, 0.0), 1.0);
    const double flat = t >= 1.0 ? 0.0 : 1.0;
    const double q = a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))));
    const double first = a1 + t * (2 * a2 + t * (3 * a3 + t * (4 * a4 + t * 5 * a5)));
    const double second = 2 * a2 + t * (6 * a3 + t * (12 * a4 + t * 20 * a5));
    *value += q * flat;
    *slope += first / length * flat;
    *bend += second / square * flat;
  }
};

// The angle from -pi up to, but not including, pi, as `wrap_angles`.
double Wrapped(double angle) {
  const double shifted = std::fmod(angle + kHalfTurn, iits::kTurn);
  return (shifted < 0.0 ? shifted + iits::kTurn : shifted) - kHalfTurn;
}

}  // namespace

// Writes offset, x, y, z, yaw and curvature of `count` points, one row after the other.
//   line: table of the reference line, see `iits::Line`.
//   road: `road_count` stations, then the road's curvature there.
//   path: `path_count` stations, then offset of the path there, its slope and second derivative.
//   quintic: null, or start, length, its square and the six coefficients.
IITS_KERNEL void iits_trajectory(const double* line, const double* road, long road_count,
                                 const double* path, long path_count, const Quintic* quintic,
                                 const double* station, long count, double* rows) {
  const Line reference(line);
  const Abscissae along(path, path_count), whole(road, road_count);
  const double *offsets = path + path_count, *slopes = offsets + path_count;
  const double *bends = slopes + path_count, *curvatures = road + road_count;
  double *offset_row = rows, *x_row = rows + count, *y_row = rows + 2 * count;
  double *z_row = rows + 3 * count, *yaw_row = rows + 4 * count, *bent_row = rows + 5 * count;
  long near = 0, near_whole = 0;
  for (long i = 0; i < count; ++i) {
    const double s = station[i];
    near = along.Find(s, near);
    double offset = along.Value(offsets, s, near), slope = along.Value(slopes, s, near);
    double bend = along.Value(bends, s, near);
    if (quintic != nullptr) quintic->Add(s, &offset, &slope, &bend);
    near_whole = whole.Find(s, near_whole);
    const double curvature = whole.Value(curvatures, s, near_whole);
    const double stretch = 1.0 - curvature * offset;
    const Line::Place place = reference.At(s);
    const Line::Pose pose = reference.PoseAt(place, offset);
    const Cubic z = reference.Piece(place, 2);
    const double roll = reference.Piece(place, 3).Value(place.t);
    offset_row[i] = offset;
    x_row[i] = pose.x;
    y_row[i] = pose.y;
    z_row[i] = z.Value(place.t) + place.beyond * z.Slope(place.t, reference.spacing()) +
               offset * std::tan(roll);
    yaw_row[i] = pose.heading + std::atan2(slope, stretch);
    // Of the offset curve, for small angles, where the truck does not move.
    bent_row[i] = curvature / stretch + bend / (stretch * stretch);
  }
  // At a point: mean of the pieces before and after it that have a length.
  double before = 0.0;
  bool moved = false;
  for (long i = 0; i < count; ++i) {
    double after = 0.0;
    bool moves = false;
    if (i + 1 < count) {
      const double way = std::hypot(x_row[i + 1] - x_row[i], y_row[i + 1] - y_row[i]);
      moves = way > kMoves;
      if (moves) after = Wrapped(yaw_row[i + 1] - yaw_row[i]) / way;
    }
    if (moves || moved) bent_row[i] = (after + before) / (moves && moved ? 2.0 : 1.0);
    before = after;
    moved = moves;
  }
}
