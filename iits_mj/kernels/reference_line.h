// Reference line of a route: cubic Hermite pieces between knots of even stations, extended along
// the tangents beyond both ends. `ReferenceLine` of iits_mj/road/reference_line.py describes it.
#ifndef IITS_MJ_KERNELS_REFERENCE_LINE_H_
#define IITS_MJ_KERNELS_REFERENCE_LINE_H_

#include <algorithm>
#include <cmath>

namespace iits {

constexpr double kTurn = 2.0 * 3.14159265358979323846;
// Farther from the line [m], a found station may belong to another part of the route.
constexpr double kLost = 50.0;

// A cubic of the way through a piece, from 0 to 1.
struct Cubic {
  double a, u, c, d;

  // Hermite polynomial between two values with their slopes, over `length`.
  Cubic(double value, double next, double slope, double next_slope, double length) {
    const double rise = next - value, v = length * next_slope;
    a = value;
    u = length * slope;
    c = 3.0 * rise - 2.0 * u - v;
    d = u + v - 2.0 * rise;
  }
  double Value(double t) const { return a + t * (u + t * (c + t * d)); }
  double Slope(double t, double length) const { return (u + t * (2.0 * c + 3.0 * t * d)) / length; }
};

class Line {
 public:
  // A table of rows of 11 numbers. The first row holds length and spacing [m] and the number of the
  // last piece. Each other row is a knot: x, y, z and superelevation, their slopes over station,
  // curvature, heading, and a number that is not used here.
  explicit Line(const double* table)
      : length_(table[0]), spacing_(table[1]), last_(table[2]), knots_(table + kColumns) {}

  // A place of the line: a piece, the way through it from 0 to 1, and the way beyond an end [m].
  struct Place {
    const double* knot;
    double t, beyond;
  };

  // Everything is not a number where the station is not a number.
  Place At(double station) const {
    double inside = station;
    if (!(station >= 0.0 && station <= length_)) {
      inside = std::min(std::max(station, 0.0), length_);
    }
    const double position = inside / spacing_;
    const double piece = position > 0.0 ? std::min(std::trunc(position), last_) : 0.0;
    return {knots_ + kColumns * static_cast<long>(piece), position - piece, station - inside};
  }

  // Cubic of a column of the knots: 0 x, 1 y, 2 z, 3 superelevation.
  Cubic Piece(const Place& place, int column) const {
    const double *knot = place.knot, *next = place.knot + kColumns;
    return Cubic(knot[column], next[column], knot[column + 4], next[column + 4], spacing_);
  }

  double Height(double station) const {
    const Place place = At(station);
    const Cubic z = Piece(place, 2);
    return z.Value(place.t) + place.beyond * z.Slope(place.t, spacing_);
  }

  struct Pose {
    double x, y, heading, sine, cosine, curvature;
  };

  // Pose of the line, moved to the left by `offset`.
  Pose PoseAt(const Place& place, double offset) const {
    const double* knot = place.knot;
    const Cubic x = Piece(place, 0), y = Piece(place, 1);
    const double dx = x.Slope(place.t, spacing_), dy = y.Slope(place.t, spacing_);
    double heading = std::atan2(dy, dx);
    heading -= kTurn * std::nearbyint((heading - knot[kHeading]) / kTurn);
    const double sine = std::sin(heading), cosine = std::cos(heading);
    const double change = knot[kColumns + kCurvature] - knot[kCurvature];
    return {x.Value(place.t) + place.beyond * cosine - offset * sine,
            y.Value(place.t) + place.beyond * sine + offset * cosine,
            heading,
            sine,
            cosine,
            std::abs(place.beyond) > 0.0 ? 0.0 : knot[kCurvature] + place.t * change};
  }

  // Finds the foot of the perpendicular from a point by Newton's method, from a station nearby;
  // returns false if it does not settle.
  bool Locate(double x, double y, double near, double* station, double* offset) const {
    *station = near;
    for (int i = 0; i < 12; ++i) {
      const Pose foot = PoseAt(At(*station), 0.0);
      const double dx = x - foot.x, dy = y - foot.y;
      const double along = dx * foot.cosine + dy * foot.sine;
      *offset = dy * foot.cosine - dx * foot.sine;
      // d(along)/d(station) = -(1 - curvature * offset)
      const double step = along / std::max(1.0 - foot.curvature * *offset, 0.2);
      *station += std::min(std::max(step, -kLost), kLost);
      if (std::abs(step) < 1e-7) return true;
    }
    return false;
  }

  double spacing() const { return spacing_; }

 private:
  static constexpr int kColumns = 11, kCurvature = 8, kHeading = 9;
  double length_, spacing_, last_;
  const double* knots_;
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_REFERENCE_LINE_H_
