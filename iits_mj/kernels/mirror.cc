// The traffic's bodies in the truck's model: which vehicles are shown, where, and which are near.
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "kernels/kernels.h"
#include "kernels/vehicle_columns.h"

using namespace iits;

namespace {

// Writes the rotation by yaw, pitch and roll (`p` is a column of `now`) as a quaternion, w first.
void Rotation(const double* p, std::ptrdiff_t n, double* q) {
  const double yaw = 0.5 * p[kYaw * n], pitch = 0.5 * p[kPitch * n], roll = 0.5 * p[kRoll * n];
  const double cy = std::cos(yaw), sy = std::sin(yaw);
  const double cp = std::cos(pitch), sp = std::sin(pitch);
  const double cr = std::cos(roll), sr = std::sin(roll);
  q[0] = cp * cr * cy + sp * sr * sy;
  q[1] = cp * sr * cy - sp * cr * sy;
  q[2] = sp * cr * cy + cp * sr * sy;
  q[3] = cp * cr * sy - sp * sr * cy;
}

// Turns a rotation about its own upward axis.
void Turn(double angle, double* q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  const double c = std::cos(0.5 * angle), s = std::sin(0.5 * angle);
  q[0] = w * c - z * s;
  q[1] = x * c + y * s;
  q[2] = y * c - x * s;
  q[3] = z * c + w * s;
}

}  // namespace

// Chooses the vehicles that are shown: of each type the nearest ones.
//
//   places: x and y of n vehicles [m], shape (2, n).
//   ranking: factor of the squared distance, summand by type, limit of the key at each rank, and
//     1.0 for the vehicles shown last, shape (4, n).
//   work: keys and order, shape (2, n).
//   chosen: 1.0 for a vehicle that is shown, shape (n,).
//
// Returns the number of vehicles that are newly shown or no longer shown.
IITS_KERNEL std::ptrdiff_t iits_mirror_choose(std::ptrdiff_t n, const double* places, double ego_x,
                                              double ego_y, const double* ranking, double* work,
                                              double* chosen) {
  const double *weight = ranking, *base = ranking + n, *limit = ranking + 2 * n;
  const double* held = ranking + 3 * n;
  double *key = work, *order = work + n;
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double dx = places[k] - ego_x, dy = places[n + k] - ego_y;
    key[k] = (dx * dx + dy * dy) * weight[k] + base[k];
    order[k] = k;
  }
  // By type, then distance, then number.
  std::sort(order, order + n, [key](double a, double b) {
    const double one = key[static_cast<std::ptrdiff_t>(a)];
    const double other = key[static_cast<std::ptrdiff_t>(b)];
    return one != other ? one < other : a < b;
  });
  std::ptrdiff_t changed = 0;
  for (std::ptrdiff_t rank = 0; rank < n; ++rank) {
    const auto k = static_cast<std::ptrdiff_t>(order[rank]);
    chosen[k] = key[k] <= limit[rank];
    changed += chosen[k] != held[k];
  }
  return changed;
}

// Writes the poses of vehicles some time after (or before) a frame.
//
// Acceleration and rates stay constant. SUMO's default scheme, semi-implicit Euler, moves a vehicle
// by v(k+1) dt in step k+1, so v(k) is the mean speed of the step that ended, and the speed at its
// end is half a step's gain higher: v(k) + a dt/2. With a constant acceleration the result meets
// SUMO's next position, v dt + a dt^2 on, and its last one, v dt back.
//
// The last step gives what the state lacks. The pace is the distance covered as a fraction of speed
// times time: neighboring lanes in a bend share SUMO's positions but differ in length, by some per
// mille; a recording with instantaneous speeds, unlike SUMO's, differs by a dt/2. The climb is how
// much the path was steeper than the pitch: beside the road's reference line a path climbs more
// than the road where the cross slope changes. A pace far from 1 means that the vehicle is new or
// was moved; then it counts as 1, and climb and rates as 0.
//
//   state: of n vehicles, shape (10, n).
//   last: the same one step before.
//   elapsed: time since the frame [s].
//   step: of the traffic [s].
//   crawl: speed below which the speeds define no direction [m/s].
//   tight: speed below which a box does not turn further with the lateral motion [m/s].
//   band: difference of the pace from 1 that is still believed.
//   now: x, y, z [m], yaw, pitch, roll [rad], shape (6, n).
IITS_KERNEL void iits_mirror_extrapolate(std::ptrdiff_t n, const double* state, const double* last,
                                         double elapsed, double step, double crawl, double tight,
                                         double band, double* now) {
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double *s = state + k, *l = last + k;
    const double yaw = s[kYaw * n], pitch = s[kPitch * n], roll = s[kRoll * n];
    const double speed = s[kSpeed * n], lateral = s[kLateralSpeed * n];
    const double covered = std::hypot(s[kX * n] - l[kX * n], s[kY * n] - l[kY * n]);
    double pace = covered / (step * std::max(std::hypot(speed, lateral), crawl));
    double pitch_rate = 0.0, roll_rate = 0.0, climb = 0.0;
    if (std::fabs(pace - 1.0) > band) {
      pace = 1.0;
    } else {
      const double turned = pitch - l[kPitch * n];
      pitch_rate = turned / step;
      roll_rate = (roll - l[kRoll * n]) / step;
      climb = (s[kZ * n] - l[kZ * n]) / covered + std::tan(pitch - 0.5 * turned);
    }
    double way = elapsed * pace * (speed + 0.5 * s[kAcceleration * n] * (step + elapsed));
    // Braking ends at standstill: a vehicle does not roll backwards.
    if (elapsed > 0.0) way = std::max(way, 0.0);
    const double turn = elapsed * s[kYawRate * n];
    // The arc is taken as its chord: shorter by less than 1e-3 at 1.5 rad/s.
    double chord = yaw + 0.5 * turn;
    if (lateral != 0.0) {
      // Speed is along the lane, and a slow vehicle's box turns less than its path.
      const double slide = std::atan2(lateral, std::max(speed, crawl));
      chord = chord + slide - std::atan2(lateral, std::max(speed, tight));
      if (speed > crawl) way = way / std::cos(slide);
    }
    const double tilt = elapsed * pitch_rate;
    double* p = now + k;
    p[kX * n] = s[kX * n] + way * std::cos(chord);
    p[kY * n] = s[kY * n] + way * std::sin(chord);
    // Pitch is positive nose down (ISO 8855); roads are measured in the plane.
    p[kZ * n] = s[kZ * n] + way * (climb - std::tan(pitch + 0.5 * tilt));
    p[kYaw * n] = yaw + turn;
    p[kPitch * n] = pitch + tilt;
    p[kRoll * n] = roll + elapsed * roll_rate;
  }
}

// Writes positions and quaternions, w first, of the first `count` of n vehicles: intrinsic
// rotations by yaw, pitch and roll.
//
//   now: x, y, z [m], yaw, pitch, roll [rad], shape (6, n).
//   position: shape (count, 3); quaternion: shape (count, 4).
IITS_KERNEL void iits_mirror_place(std::ptrdiff_t count, std::ptrdiff_t n, const double* now,
                                   double* position, double* quaternion) {
  for (std::ptrdiff_t k = 0; k < count; ++k) {
    const double* p = now + k;
    for (int axis = 0; axis < 3; ++axis) position[3 * k + axis] = p[axis * n];
    Rotation(p, n, quaternion + 4 * k);
  }
}

// Writes the poses of tractors and semitrailers, the last of n vehicles, in the plane of the road
// under them: positions of the kingpins on the ground, and quaternions.
//
// The tractor points in the direction in which the kingpin moves. The fifth wheel counts as above
// the drive axle, which does not slip sideways. The box's center moves towards its yaw, which turns
// the semitrailer at v sin(delta) / d; the kingpin, e ahead, moves across the semitrailer by
// v sin(delta) (1 + e / d) and along it by v cos(delta).
//
//   first: number of the first of these vehicles.
//   now: x, y, z [m], yaw, pitch, roll [rad], shape (6, n).
//   trucks: e and d of each [m], shape (2, n - first).
//   trailer: yaw of each semitrailer [rad].
//   position, quaternion: of n + (n - first) units, see `iits_mirror_place`.
IITS_KERNEL void iits_mirror_articulate(std::ptrdiff_t first, std::ptrdiff_t n, const double* now,
                                        const double* trucks, const double* trailer,
                                        double* position, double* quaternion) {
  const std::ptrdiff_t count = n - first;
  for (std::ptrdiff_t k = 0; k < count; ++k) {
    const double *p = now + first + k, kingpin = trucks[k], axles = trucks[count + k];
    const double yaw = p[kYaw * n], pitch = p[kPitch * n], roll = p[kRoll * n];
    const double cy = std::cos(yaw), sy = std::sin(yaw);
    const double cp = std::cos(pitch), sp = std::sin(pitch);
    const double cr = std::cos(roll), sr = std::sin(roll);
    const double bend = trailer[k] - yaw, delta = yaw - trailer[k];
    // The box's forward and left axes: columns of the rotation by yaw, pitch and roll.
    const double forward = kingpin * std::cos(bend), left = kingpin * std::sin(bend);
    const double across = std::sin(delta) * (1.0 + kingpin / axles);
    const double turn = trailer[k] + std::atan2(across, std::cos(delta)) - yaw;
    for (const std::ptrdiff_t unit : {first + k, n + k}) {
      double* place = position + 3 * unit;
      place[0] = p[kX * n] + forward * cy * cp + left * (cy * sp * sr - sy * cr);
      place[1] = p[kY * n] + forward * sy * cp + left * (sy * sp * sr + cy * cr);
      place[2] = p[kZ * n] - forward * sp + left * cp * sr;
      Rotation(p, n, quaternion + 4 * unit);
      Turn(unit < n ? turn : bend, quaternion + 4 * unit);
    }
  }
}

// Writes the poses of n units into MuJoCo's mocap bodies.
//
//   body: number of each unit's mocap body.
//   position: shape (n, 3); quaternion: shape (n, 4).
//   mocap_position, mocap_quaternion: of all mocap bodies.
IITS_KERNEL void iits_mirror_show(std::ptrdiff_t n, const double* body, const double* position,
                                  const double* quaternion, double* mocap_position,
                                  double* mocap_quaternion) {
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const auto number = static_cast<std::ptrdiff_t>(body[k]);
    std::copy_n(position + 3 * k, 3, mocap_position + 3 * number);
    std::copy_n(quaternion + 4 * k, 4, mocap_quaternion + 4 * number);
  }
}

// Finds the units whose circles are within a distance [m] of those of the truck's parts.
//
//   position: of n units, shape (n, 3) [m]; radius: of each [m].
//   geom: number of the geom of each of m parts; part: radius of each [m].
//   center: of all geoms, shape (count, 3) [m].
//   found: numbers of these units, shape (n,).
//
// Returns how many they are.
IITS_KERNEL std::ptrdiff_t iits_mirror_near(std::ptrdiff_t n, const double* position,
                                            const double* radius, std::ptrdiff_t m,
                                            const double* geom, const double* part,
                                            const double* center, double distance, double* found) {
  std::ptrdiff_t count = 0;
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    for (std::ptrdiff_t i = 0; i < m; ++i) {
      const double* other = center + 3 * static_cast<std::ptrdiff_t>(geom[i]);
      const double dx = position[3 * k] - other[0], dy = position[3 * k + 1] - other[1];
      const double within = radius[k] + part[i] + distance;
      if (!(dx * dx + dy * dy < within * within)) continue;
      found[count++] = k;
      break;
    }
  }
  return count;
}
