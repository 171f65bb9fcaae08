// Road surface: a table of the route's reference line.
//
// A row has 11 numbers: x, y, z [m], cos(heading), sin(heading), curvature [1/m], grade [1],
// tan(superelevation), friction left, friction right, offset of the friction split [m]. The height
// is C1: cubic Hermite in station, linear across the road. Unevenness is a grid of heights after
// the rows, which repeats in both directions; its height is C1 along the road and linear across.
#ifndef IITS_MJ_PLUGIN_LAWS_ROAD_H_
#define IITS_MJ_PLUGIN_LAWS_ROAD_H_

#include "plugin/laws/number.h"

namespace iits {

// The surface at one point, or at the two points of a Pair.
template <class T>
struct RoadPoint {
  T height;    // [m]
  T up[3];     // along the normal, world frame, with up[2] = 1
  T norm;      // factor that makes `up` the unit normal
  T friction;  // of the surface
  T station;   // [m], also the hint for the next call
};

struct RoadTable {
  static constexpr int kColumns = 11;
  static constexpr double kUnknownStation = -1e10;
  static constexpr double kFlatFriction = 0.8;  // dry asphalt, without a road table

  enum Column { kX, kY, kZ, kCos, kSin, kCurvature, kGrade, kTilt, kMuLeft, kMuRight, kSplit };

  int count = 0;  // rows; 0: the plane z = 0
  double start = 0, step = 1, inverse_step = 1;
  int grid_rows = 0, grid_columns = 0;     // of the unevenness; 0: a smooth road
  double grid_along = 1, grid_across = 1;  // steps [m]

  // Surface at the point (x, y); `station_hint` is kUnknownStation or the station of a point
  // nearby. The hint affects the result only where the road passes over itself.
  template <class T>
  RoadPoint<T> Evaluate(const double* rows, T x, T y, T station_hint) const {
    RoadPoint<T> point;
    if (count == 0) {
      point.height = point.station = point.up[0] = point.up[1] = Fill<T>(0);
      point.up[2] = point.norm = Fill<T>(1);
      point.friction = Fill<T>(kFlatFriction);
      return point;
    }
    const double* at[kLanes<T>];
    const T row = Each<T>([&](int k) {
      const int i = FindRow(rows, Lane(x, k), Lane(y, k), Lane(station_hint, k));
      at[k] = rows + i * kColumns;
      return 1. * i;
    });
    auto first = [&at](Column c) { return Each<T>([&at, c](int k) { return at[k][c]; }); };
    auto second = [&at](Column c) {
      return Each<T>([&at, c](int k) { return at[k][kColumns + c]; });
    };

    // Distances along and across the road from both rows, and the position between them.
    const T x0 = x - first(kX), y0 = y - first(kY), x1 = x - second(kX), y1 = y - second(kY);
    const T c0 = first(kCos), s0 = first(kSin), c1 = second(kCos), s1 = second(kSin);
    const T a0 = x0 * c0 + y0 * s0, a1 = x1 * c1 + y1 * s1;
    const T span = a0 - a1;
    const T raw = span > 1e-9 ? a0 / span : Fill<T>(0);
    const T u = Clamp(raw, 0., 1.), v = 1 - u;
    // Beyond either end: along the end's tangent.
    const T beyond = raw < 0 ? a0 : (raw > 1 ? a1 : Fill<T>(0));
    point.station = start + (row + u) * step + beyond;

    const T z0 = first(kZ), rise = second(kZ) - z0;
    const T g0 = first(kGrade) * step, g1 = second(kGrade) * step;
    const T cubic = g0 + g1 - 2 * rise, square = 3 * rise - 2 * g0 - g1;
    const T slope = (g0 + u * (2 * square + 3 * u * cubic)) * inverse_step;
    const T z = z0 + u * (g0 + u * (square + u * cubic)) + slope * beyond;

    const T offset = v * (y0 * c0 - x0 * s0) + u * (y1 * c1 - x1 * s1);
    const T tilt0 = first(kTilt), tilt1 = second(kTilt);
    T tilt = v * tilt0 + u * tilt1;
    const T curvature = v * first(kCurvature) + u * second(kCurvature);
    const T cosine = v * c0 + u * c1, sine = v * s0 + u * s1;
    point.height = z + offset * tilt;
    // Slope along the line at this offset, which is longer or shorter than the reference line.
    const T stretch = Max(1 - curvature * offset, 0.2);
    T along = (slope + offset * (tilt1 - tilt0) * inverse_step) / stretch;
    if (grid_rows > 0) {
      T uneven[3];
      Unevenness(rows + count * kColumns, point.station, offset, uneven);
      point.height += uneven[0];
      along += uneven[1] / stretch;
      tilt += uneven[2];
    }
    point.up[0] = tilt * sine - along * cosine;
    point.up[1] = -along * sine - tilt * cosine;
    point.up[2] = Fill<T>(1);
    point.norm = 1 / sqrt(point.up[0] * point.up[0] + point.up[1] * point.up[1] + 1);
    const auto right = offset < first(kSplit);
    point.friction = v * (right ? first(kMuRight) : first(kMuLeft)) +
                     u * (right ? second(kMuRight) : second(kMuLeft));
    return point;
  }

 private:
  // Height of the grid at a place, and its slopes along and across the road: Catmull-Rom spline
  // along, linear across.
  template <class T>
  void Unevenness(const double* grid, T station, T offset, T out[3]) const {
    decltype(Lane(station, 0)) found[kLanes<T>][3];
    for (int k = 0; k < kLanes<T>; ++k) {
      auto s = Lane(station, k) / grid_along, y = Lane(offset, k) / grid_across;
      const int row = Cell(&s, grid_rows), column = Cell(&y, grid_columns);
      const int next = column + 1 < grid_columns ? column + 1 : 0;
      decltype(s) height[2], slope[2];
      for (int side = 0; side < 2; ++side) {
        double h[4];
        for (int i = 0; i < 4; ++i) {
          const int at = (row + i + grid_rows - 1) % grid_rows;
          h[i] = grid[at * grid_columns + (side ? next : column)];
        }
        const double a = 0.5 * (h[2] - h[0]), b = h[0] - 2.5 * h[1] + 2 * h[2] - 0.5 * h[3],
                     c = 0.5 * (h[3] - h[0]) + 1.5 * (h[1] - h[2]);
        height[side] = h[1] + s * (a + s * (b + s * c));
        slope[side] = a + s * (2 * b + 3 * s * c);
      }
      found[k][0] = height[0] + y * (height[1] - height[0]);
      found[k][1] = (slope[0] + y * (slope[1] - slope[0])) / grid_along;
      found[k][2] = (height[1] - height[0]) / grid_across;
    }
    for (int i = 0; i < 3; ++i) out[i] = Each<T>([&](int k) { return found[k][i]; });
  }

  // Cell of a grid that repeats after `cells`; leaves the place within the cell, 0 to 1.
  template <class T>
  static int Cell(T* place, int cells) {
    const T whole = floor(*place);
    *place = *place - whole;
    return Whole(whole - cells * floor(whole / cells), 0, cells - 1);
  }

  static constexpr int kCoarseStride = 32;  // of the global search
  static constexpr int kWalkMax = 64;       // rows from the hint, then the global search
  static constexpr double kFarOffset = 40;  // [m]; farther off the road, a hint may be wrong

  template <class T>
  static T Along(const double* row, T x, T y) {
    return (x - row[kX]) * row[kCos] + (y - row[kY]) * row[kSin];
  }
  template <class T>
  static T Across(const double* row, T x, T y) {
    return (y - row[kY]) * row[kCos] - (x - row[kX]) * row[kSin];
  }

  // Row of the section with the point; beyond the road's ends, of the nearest section.
  template <class T>
  int FindRow(const double* rows, T x, T y, T station_hint) const {
    const int last = count - 2;
    int row = 0;
    if (station_hint > 0.1 * kUnknownStation) {
      row = Whole((station_hint - start) * inverse_step, 0, last);
      // Walk along the road to the section with the point.
      int walked = 0;
      while (row < last && walked < kWalkMax && Along(rows + (row + 1) * kColumns, x, y) >= 0) {
        ++row;
        ++walked;
      }
      while (row > 0 && walked < kWalkMax && Along(rows + row * kColumns, x, y) < 0) {
        --row;
        ++walked;
      }
      if (walked < kWalkMax && abs(Across(rows + row * kColumns, x, y)) < kFarOffset) return row;
    }
    // Global search: the nearest row of a coarse pass, then its neighborhood.
    T best = kInfinity;
    for (int i = 0; i < count; i += kCoarseStride) {
      const double* r = rows + i * kColumns;
      const T distance = (x - r[kX]) * (x - r[kX]) + (y - r[kY]) * (y - r[kY]);
      if (distance < best) {
        best = distance;
        row = i;
      }
    }
    row = Min(row, last);
    while (row < last && Along(rows + (row + 1) * kColumns, x, y) >= 0) ++row;
    while (row > 0 && Along(rows + row * kColumns, x, y) < 0) --row;
    return row;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_ROAD_H_
