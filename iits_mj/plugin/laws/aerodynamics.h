// Aerodynamics: drag and side force at a center of pressure, and the mean drag in a wind that comes
// from all directions.
#ifndef IITS_MJ_PLUGIN_LAWS_AERODYNAMICS_H_
#define IITS_MJ_PLUGIN_LAWS_AERODYNAMICS_H_

#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"

namespace iits {

template <class T>
struct Aerodynamics {
  // Attributes; an area includes its coefficient.
  T density, drag_area, side_area;
  Curve<T> increase;  // of the drag area over the yaw angle of the air, 0 to below pi/2; or empty
  T mean_wind = 0;    // [m/s]
  // Derived by Prepare.
  Sampled<T> addition;  // MeanAddition over the forward speed

  // Samples the mean over the wind's direction.
  void Prepare() {
    if (mean_wind == 0) return;
    addition.Sample([this](T speed) { return MeanAddition(speed); }, 0, kSpeedMax, kSpeedMax * 2);
  }

  // Force along the body's x and y axes [N]: F = -1/2 density |v| v_i area_i, with `forward` and
  // `left` the body's velocity relative to the air along these axes, `speed` its magnitude [m/s].
  // The drag area rises with the yaw angle of the air, and the drag by the mean addition of a wind
  // from all directions.
  void Force(T speed, T forward, T left, T force[2]) const {
    force[0] = -0.5 * density * drag_area * speed * forward;
    force[1] = -0.5 * density * side_area * speed * left;
    if (!increase.x.empty()) force[0] -= 0.5 * density * YawAddition(speed, forward, left);
    if (mean_wind != 0) {
      const T ahead = abs(forward);
      const T added = addition(ahead, [this](T v) { return MeanAddition(v); });
      force[0] -= 0.5 * density * (forward < 0 ? -added : added);
    }
  }

 private:
  static constexpr int kSpeedMax = 60;     // of the samples [m/s]; faster air takes the integral
  static constexpr int kDirections = 180;  // of the wind over half a turn
  static constexpr double kPi = 3.14159265358979323846;

  // The drag that the yaw angle adds, over density / 2. Beyond the last angle of the curve it falls
  // with the angle's cosine, to zero for air from the side, where the drag changes its sign.
  T YawAddition(T speed, T forward, T left) const {
    const T ahead = abs(forward), last = increase.x.back();
    const T yaw = atan(abs(left) / Max(ahead, 1e-9));
    T area = increase(yaw);
    if (yaw > last) area *= cos(yaw) / cos(last);
    return (forward < 0 ? -area : area) * speed * speed;
  }

  // Mean over the wind's direction of the drag at a forward speed, less the drag in calm air; over
  // density / 2. A mean over equal steps, since the drag is periodic in the direction.
  T MeanAddition(T ahead) const {
    T sum = 0;
    for (int i = 0; i < kDirections; ++i) {
      const double direction = kPi * (i + 0.5) / kDirections;
      const T forward = ahead - mean_wind * std::cos(direction);
      const T left = mean_wind * std::sin(direction);
      const T speed = sqrt(forward * forward + left * left);
      sum += drag_area * speed * forward;
      if (!increase.x.empty()) sum += YawAddition(speed, forward, left);
    }
    return sum / kDirections - drag_area * abs(ahead) * ahead;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_AERODYNAMICS_H_
