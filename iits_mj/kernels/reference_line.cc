// Look-ups at single places of a route's reference line; `line` is the table of `iits::Line`.
#include "kernels/reference_line.h"

#include "kernels/kernels.h"

using iits::Cubic;
using iits::Line;

// Writes x, y, z, heading, curvature, grade and superelevation of a point of the road surface.
IITS_KERNEL void iits_line_evaluate(const double* table, double station, double offset,
                                    double* point) {
  const Line line(table);
  const Line::Place place = line.At(station);
  const Line::Pose pose = line.PoseAt(place, offset);
  const Cubic z = line.Piece(place, 2);
  const double grade = z.Slope(place.t, line.spacing());
  const double roll = line.Piece(place, 3).Value(place.t);
  point[0] = pose.x;
  point[1] = pose.y;
  point[2] = z.Value(place.t) + place.beyond * grade + offset * std::tan(roll);
  point[3] = pose.heading;
  point[4] = pose.curvature;
  point[5] = grade;
  point[6] = roll;
}

IITS_KERNEL double iits_line_height(const double* table, double station) {
  return Line(table).Height(station);
}

// Mean grade over a window [m] about a station.
IITS_KERNEL double iits_line_mean_grade(const double* table, double station, double window) {
  const Line line(table);
  const double half = 0.5 * window;
  return (line.Height(station + half) - line.Height(station - half)) / window;
}

// Writes station and offset of a point near a station; returns 0 if none was found.
IITS_KERNEL long iits_line_locate(const double* table, double x, double y, double near,
                                  double* found) {
  return Line(table).Locate(x, y, near, found, found + 1);
}
