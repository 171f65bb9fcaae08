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
    return true;
  }
  address_ = -1;
  return true;
}

int Road::FindRow(const double* rows, double x, double y, double station_hint) const {
  const int last = count_ - 2;
  int row = 0;
  bool known = station_hint > 0.1 * kUnknownStation;
  if (known) {
    row = std::clamp(static_cast<int>((station_hint - start_) / step_), 0, last);
    // Walk along the road to the section that holds the point.
    int walked = 0;
    while (row < last && walked < 64 && Along(rows + (row + 1) * kColumns, x, y) >= 0) {
      ++row;
      ++walked;
    }
    while (row > 0 && walked < 64 && Along(rows + row * kColumns, x, y) < 0) {
      --row;
      ++walked;
    }
    if (walked < 64 && std::abs(Across(rows + row * kColumns, x, y)) < kFarOffset) return row;
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

RoadPoint Road::Evaluate(const mjModel* m, double x, double y, double station_hint) const {
  RoadPoint point;
  if (address_ < 0) {
    point.height = 0;
    point.normal[0] = point.normal[1] = 0;
    point.normal[2] = 1;
    point.friction = kFlatFriction;
    point.station = 0;
    return point;
  }
  const double* rows = m->numeric_data + address_;
  int index = FindRow(rows, x, y, station_hint);
  const double* r0 = rows + index * kColumns;
  const double* r1 = r0 + kColumns;
  double a0 = Along(r0, x, y);
  double a1 = Along(r1, x, y);
  double span = a0 - a1;
  double u = span > 1e-9 ? a0 / span : 0;

  double z, slope;
  if (u < 0 || u > 1) {
    // Beyond either end: along the end's tangent.
    const double* r = u < 0 ? r0 : r1;
    double beyond = u < 0 ? a0 : a1;
    u = u < 0 ? 0 : 1;
    z = r[kZ] + r[kGrade] * beyond;
    slope = r[kGrade];
    point.station = start_ + (index + u) * step_ + beyond;
  } else {
    double g0 = r0[kGrade] * step_, g1 = r1[kGrade] * step_;
    double rise = r1[kZ] - r0[kZ];
    double c3 = g0 + g1 - 2 * rise;
    double c2 = 3 * rise - 2 * g0 - g1;
    z = r0[kZ] + u * (g0 + u * (c2 + u * c3));
    slope = (g0 + u * (2 * c2 + 3 * u * c3)) / step_;
    point.station = start_ + (index + u) * step_;
  }
  double v = 1 - u;
  double offset = v * Across(r0, x, y) + u * Across(r1, x, y);
  double tilt = v * r0[kTilt] + u * r1[kTilt];
  double curvature = v * r0[kCurvature] + u * r1[kCurvature];
  double cosine = v * r0[kCos] + u * r1[kCos];
  double sine = v * r0[kSin] + u * r1[kSin];

  point.height = z + offset * tilt;
  // Slope along the offset line, which is longer or shorter than the reference line.
  double stretch = std::max(0.2, 1 - curvature * offset);
  double along = (slope + offset * (r1[kTilt] - r0[kTilt]) / step_) / stretch;
  double nx = -along * cosine + tilt * sine;
  double ny = -along * sine - tilt * cosine;
  double norm = 1 / std::sqrt(nx * nx + ny * ny + 1);
  point.normal[0] = nx * norm;
  point.normal[1] = ny * norm;
  point.normal[2] = norm;
  point.friction =
      offset < r0[kSplit] ? v * r0[kMuRight] + u * r1[kMuRight] : v * r0[kMuLeft] + u * r1[kMuLeft];
  return point;
}

}  // namespace iits
