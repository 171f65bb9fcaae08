// The truck's neighbors: which vehicles are on its road, in a lane, or in its corridor.
// `Neighbors` of iits_mj/core/neighbors.py describes the queries.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "kernels/interpolation.h"
#include "kernels/kernels.h"
#include "kernels/vehicle_columns.h"

using namespace iits;

namespace {

constexpr double kTurn = 2.0 * 3.14159265358979323846;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The columns of n vehicles, then gap and front distance.
struct Vehicles {
  Vehicles(double* columns, std::ptrdiff_t n)
      : z(columns + kZ * n),
        yaw(columns + kYaw * n),
        speed(columns + kSpeed * n),
        lateral_speed(columns + kLateralSpeed * n),
        station(columns + kStation * n),
        offset(columns + kOffset * n),
        length(columns + kLength * n),
        width(columns + kWidth * n),
        gap(columns + kColumns * n),
        front_distance(columns + (kColumns + 1) * n),
        x_(columns + kX * n),
        y_(columns + kY * n) {}

  // Whether a vehicle has a pose.
  bool Posed(std::ptrdiff_t k) const { return x_[k] != 0.0 || y_[k] != 0.0 || z[k] != 0.0; }

  const double *z, *yaw, *speed, *lateral_speed, *station, *offset, *length, *width;
  double *gap, *front_distance;

 private:
  const double *x_, *y_;
};

}  // namespace

// Writes gap and front distance of n vehicles.
//   front, rear: stations of the truck's front bumper and of the trailer's rear.
// Returns whether all their numbers are finite.
IITS_KERNEL std::ptrdiff_t iits_neighbors(double* columns, std::ptrdiff_t n, double front,
                                          double rear) {
  double rest = 0.0;
  for (std::ptrdiff_t i = 0; i < kColumns * n; ++i) rest += columns[i] - columns[i];
  const Vehicles all(columns, n);
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double half = 0.5 * all.length[k];
    all.gap[k] = std::max(all.station[k] - half - front, rear - all.station[k] - half);
    all.front_distance[k] = all.station[k] + half - front;
  }
  return rest == 0.0;
}

// Finds the vehicles on a road's level, and those that drive along it for certain.
//   road: stations, then rows of numbers there; `rows` are those of height, superelevation,
//     heading and its swing.
//   step: between two stations.
//   reach: distance above or below the road within which a vehicle is on it.
//   angle: from the road's direction within which a vehicle drives along it.
//   level, along: flags of the vehicles.
// Returns the number of vehicles on the level that may drive in another direction.
IITS_KERNEL std::ptrdiff_t iits_on_road(double* columns, std::ptrdiff_t n, const double* road,
                                        std::ptrdiff_t count, std::ptrdiff_t first_row, double step,
                                        double reach, double angle, bool* level, bool* along) {
  const Vehicles all(columns, n);
  const Abscissae places(road, count);
  const double *height = road + first_row * count, *bank = height + count;
  const double *heading = bank + count, *swing = heading + count;
  std::ptrdiff_t others = 0;
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const bool posed = all.Posed(k);
    const double last = static_cast<double>(count - 1);
    const double row = std::min(std::max(std::nearbyint(all.station[k] / step), 0.0), last);
    const long near = static_cast<long>(row);
    const long found = places.Find(all.station[k], all.station[k] < road[near] ? near - 1 : near);
    const double roll = places.Value(bank, all.station[k], found);
    const double surface =
        places.Value(height, all.station[k], found) + all.offset[k] * std::tan(roll);
    level[k] = !posed || std::fabs(all.z[k] - surface) < reach;
    const double turned = std::remainder(all.yaw[k] - heading[near], kTurn);
    along[k] = posed && all.speed[k] >= 0.0 && std::fabs(turned) < angle - swing[near];
    others += level[k] && !along[k];
  }
  return others;
}

// Finds the vehicles in a lane that is followed along the road.
//   path: stations, then rows of numbers there; the last row is the offset of the lane's middle.
//   end: station of the lane's end.
//   intrusion: least way of a body into the lane; soon: time within which a vehicle may enter it.
//   entering: time within which vehicles count that cross into the lane, faster than `weaving`.
//   level: flags of the vehicles on the lane's level, or null.
//   front: station of the truck's front bumper.
//   inside: flags of the vehicles.
// Returns the number of the nearest vehicle ahead of the front, -1 for none.
IITS_KERNEL std::ptrdiff_t iits_along_path(double* columns, std::ptrdiff_t n, const double* path,
                                           std::ptrdiff_t rows, std::ptrdiff_t count,
                                           double half_width, double end, double intrusion,
                                           double soon, double entering, double weaving,
                                           const bool* level, double front, bool* inside) {
  const Vehicles all(columns, n);
  const Abscissae places(path, count);
  const double* middles = path + (rows - 1) * count;
  std::ptrdiff_t leader = -1;
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double station = all.station[k], offset = all.offset[k], aside = all.lateral_speed[k];
    inside[k] = false;
    if (station < path[0] || station > path[count - 1] || station > end) continue;
    if (level != nullptr && !level[k]) continue;
    const long near = static_cast<long>((station - path[0]) / (path[1] - path[0]));
    const double middle = places.Value(middles, station, places.Find(station, near));
    const double reach = half_width + 0.5 * all.width[k] - intrusion;
    auto in_lane = [&](double place) { return std::fabs(place - middle) < reach; };
    inside[k] = in_lane(offset) || in_lane(offset + soon * aside);
    if (entering > 0.0 && std::fabs(aside) > weaving) {
      // A vehicle that will have crossed the whole lane by then has been in it.
      const double later = offset + entering * aside;
      inside[k] = inside[k] || in_lane(later) || (offset - middle) * (later - middle) < 0.0;
    }
    const bool ahead = inside[k] && station > front;
    if (ahead && (leader < 0 || all.gap[k] < all.gap[leader])) leader = k;
  }
  return leader;
}

// Writes the least gaps ahead of and behind the truck's corridor, infinite without a vehicle.
//   lanes: of the vehicles, -1 off the road; lane: the truck's.
//   offset, width, z: the truck's; middle: station of its center.
//   reach: greatest difference of height to a vehicle off the road.
IITS_KERNEL void iits_corridor_gaps(double* columns, std::ptrdiff_t n, const std::ptrdiff_t* lanes,
                                    std::ptrdiff_t lane, double offset, double width, double z,
                                    double middle, double reach, double* gaps) {
  const Vehicles all(columns, n);
  gaps[0] = gaps[1] = kInfinity;
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const bool beside = std::fabs(all.offset[k] - offset) < 0.5 * (all.width[k] + width);
    if (!beside && !(lane >= 0 && lanes[k] == lane)) continue;
    if (lanes[k] < 0 && !(std::fabs(all.z[k] - z) < reach)) continue;
    double& least = gaps[all.station[k] >= middle ? 0 : 1];
    least = std::min(least, all.gap[k]);
  }
}
