#include "plugin/retarder.h"

#include <mujoco/mujoco.h>

#include <algorithm>

#include "plugin/config.h"

namespace iits {

bool Retarder::Read(const mjModel* m, int instance) {
  const Attribute attributes[] = {
      {"retarder_torque_max", 0, 1e5, &torque_max_},
      {"retarder_full_torque_speed", 1, 1000, &full_torque_speed_},
      {"retarder_power_max", 1, 1e7, &power_max_},
      {"retarder_power_continuous", 1, 1e7, &power_continuous_},
      {"retarder_heat_time", 0.1, 1e4, &heat_time_},
      {"retarder_derate_heat", 0, 0.99, &derate_heat_},
      {"retarder_fill_time", 0.001, 10, &fill_time_},
      {"retarder_empty_time", 0.001, 10, &empty_time_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  if (power_continuous_ > power_max_) {
    mju_warning(
        "plugin instance '%s': retarder_power_continuous %g must not exceed "
        "retarder_power_max %g",
        InstanceName(m, instance).c_str(), power_continuous_, power_max_);
    return false;
  }
  return true;
}

double Retarder::Available(double shaft_speed, double heat) const {
  if (shaft_speed <= 0) return 0;
  const double rise = std::min(1.0, shaft_speed / full_torque_speed_);
  const double cool = std::clamp((1 - heat) / (1 - derate_heat_), 0.0, 1.0);
  const double power = power_continuous_ + cool * (power_max_ - power_continuous_);
  return std::min(torque_max_ * rise * rise, power / shaft_speed);
}

// Heat: d(heat)/dt = (P / P_continuous - heat) / heat_time, so that continuous power ends at 1.
double Retarder::Update(double wanted, double available, double shaft_speed, double h,
                        RetarderState* s) const {
  const double target = wanted > 0 && available > 0 ? std::min(1.0, wanted / available) : 0;
  const double lag = target > s->fill ? fill_time_ : empty_time_;
  s->fill += (target - s->fill) * h / (lag + h);
  const double torque = s->fill * available;
  const double power = torque * shaft_speed;
  s->heat += (power / power_continuous_ - s->heat) * h / (heat_time_ + h);
  return torque;
}

}  // namespace iits
