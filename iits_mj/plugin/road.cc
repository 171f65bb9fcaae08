#include "plugin/road.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "plugin/config.h"

namespace iits {
namespace {

constexpr int kVersion = 1;
constexpr int kHeader = 4;
constexpr int kColumns = 11;
constexpr double kFlatFriction = 0.8;  // dry asphalt, for scenes without a road
constexpr int kCoarseStride = 32;      // of the global search
constexpr int kWalkMax = 64;           // rows from the hint, then the global search
constexpr double kFarOffset = 40;      // [m]; farther off the hint is doubted

enum Column { kX, kY, kZ, kCos, kSin, kCurvature, kGrade, kTilt, kMuLeft, kMuRight, kSplit };

double Along(const double* row, double x, double y) {
  return (x - row[kX]) * row[kCos] + (y - row[kY]) * row[kSin];
}

double Across(const double* row, double x, double y) {
  return (y - row[kY]) * row[kCos] - (x - row[kX]) * row[kSin];
}

}  // namespace

bool Road::Bind(const mjModel* m, int instance) {
  for (int i = 0; i < m->nnumeric; ++i) {
    if (LocalName(m->names + m->name_numericadr[i]) != "iits_road") continue;
    const double* data = m->numeric_data + m->numeric_adr[i];
    int size = m->numeric_size[i];
    bool valid = size >= kHeader && data[0] == kVersion && data[1] >= 2 && data[3] > 0 &&
                 size == kHeader + kColumns * static_cast<int>(data[1]);
    if (!valid) {
      mju_warning("plugin instance '%s': numeric 'iits_road' (%d numbers) is not a road table",
                  InstanceName(m, instance).c_str(), size);
      return false;
    }
    address_ = m->numeric_adr[i] + kHeader;
    count_ = static_cast<int>(data[1]);
    start_ = data[2];
    step_ = data[3];
    inverse_step_ = 1 / step_;
    return true;
  }
  address_ = -1;
  return true;
}

// Row whose section holds the point, or the nearest end's.
int Road::FindRow(const double* rows, double x, double y, double station_hint) const {
  const int last = count_ - 2;
  int row = 0;
  if (station_hint > 0.1 * kUnknownStation) {
    row = std::clamp(static_cast<int>((station_hint - start_) * inverse_step_), 0, last);
    // Walk along the road to the section that holds the point.
    int walked = 0;
    while (row < last && walked < kWalkMax && Along(rows + (row + 1) * kColumns, x, y) >= 0) {
      ++row;
      ++walked;
    }
    while (row > 0 && walked < kWalkMax && Along(rows + row * kColumns, x, y) < 0) {
      --row;
      ++walked;
    }
    if (walked < kWalkMax && std::abs(Across(rows + row * kColumns, x, y)) < kFarOffset) return row;
  }
  // Global search: nearest row of a coarse pass, then of its neighbourhood.
  double best = kInfinity;
  for (int i = 0; i < count_; i += kCoarseStride) {
    const double* r = rows + i * kColumns;
    double distance = (x - r[kX]) * (x - r[kX]) + (y - r[kY]) * (y - r[kY]);
    if (distance < best) {
      best = distance;
      row = i;
    }
  }
  row = std::min(row, last);
  while (row < last && Along(rows + (row + 1) * kColumns, x, y) >= 0) ++row;
  while (row > 0 && Along(rows + row * kColumns, x, y) < 0) --row;
  return row;
}

RoadPoints Road::Evaluate(const mjModel* m, Pair x, Pair y, Pair station_hint) const {
  RoadPoints point;
  if (address_ < 0) {
    point.height = point.station = point.up[0] = point.up[1] = Both(0);
    point.up[2] = point.norm = Both(1);
    point.friction = Both(kFlatFriction);
    return point;
  }
  const double* rows = m->numeric_data + address_;
  const int i = FindRow(rows, x[0], y[0], station_hint[0]);
  const int j = FindRow(rows, x[1], y[1], station_hint[1]);
  const double* at[2] = {rows + i * kColumns, rows + j * kColumns};
  auto first = [&at](Column c) { return Pair{at[0][c], at[1][c]}; };
  auto second = [&at](Column c) { return Pair{at[0][kColumns + c], at[1][kColumns + c]}; };

  // Distances along and across the road from both rows, and the place between them.
  const Pair x0 = x - first(kX), y0 = y - first(kY), x1 = x - second(kX), y1 = y - second(kY);
  const Pair c0 = first(kCos), s0 = first(kSin), c1 = second(kCos), s1 = second(kSin);
  const Pair a0 = x0 * c0 + y0 * s0, a1 = x1 * c1 + y1 * s1;
  const Pair span = a0 - a1;
  const Pair raw = span > 1e-9 ? a0 / span : Both(0);
  const Pair u = Min(Max(raw, Both(0)), Both(1)), v = 1 - u;
  // Beyond either end: along the end's tangent.
  const Pair beyond = raw < 0 ? a0 : (raw > 1 ? a1 : Both(0));
  point.station = start_ + (Pair{1. * i, 1. * j} + u) * step_ + beyond;

  const Pair z0 = first(kZ), rise = second(kZ) - z0;
  const Pair g0 = first(kGrade) * step_, g1 = second(kGrade) * step_;
  const Pair cubic = g0 + g1 - 2 * rise, square = 3 * rise - 2 * g0 - g1;
  const Pair slope = (g0 + u * (2 * square + 3 * u * cubic)) * inverse_step_;
  const Pair z = z0 + u * (g0 + u * (square + u * cubic)) + slope * beyond;

  const Pair offset = v * (y0 * c0 - x0 * s0) + u * (y1 * c1 - x1 * s1);
  const Pair tilt0 = first(kTilt), tilt1 = second(kTilt);
  const Pair tilt = v * tilt0 + u * tilt1;
  const Pair curvature = v * first(kCurvature) + u * second(kCurvature);
  const Pair cosine = v * c0 + u * c1, sine = v * s0 + u * s1;
  point.height = z + offset * tilt;
  // Slope along the offset line, which is longer or shorter than the reference line.
  const Pair stretch = Max(1 - curvature * offset, Both(0.2));
  const Pair along = (slope + offset * (tilt1 - tilt0) * inverse_step_) / stretch;
  point.up[0] = tilt * sine - along * cosine;
  point.up[1] = -along * sine - tilt * cosine;
  point.up[2] = Both(1);
  point.norm = 1 / Sqrt(point.up[0] * point.up[0] + point.up[1] * point.up[1] + 1);
  const PairMask right = offset < first(kSplit);
  point.friction = v * (right ? first(kMuRight) : first(kMuLeft)) +
                   u * (right ? second(kMuRight) : second(kMuLeft));
  return point;
}

}  // namespace iits
