#include "plugin/brake_distribution.h"

#include <mujoco/mujoco.h>

#include <algorithm>

#include "plugin/config.h"
#include "plugin/lookup.h"

namespace iits {

bool BrakeDistribution::Read(const mjModel* m, int instance) {
  const Attribute attributes[] = {
      {"mass_light", 1, 1e6, &mass_light_},
      {"mass_heavy", 1, 1e6, &mass_heavy_},
      {"push_out_pressure", 0, 1e6, &push_out_pressure_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  if (mass_heavy_ <= mass_light_) {
    mju_warning("plugin instance '%s': attribute 'mass_heavy' = %g must exceed mass_light = %g",
                InstanceName(m, instance).c_str(), mass_heavy_, mass_light_);
    return false;
  }
  if (!ReadNumbers(m, instance, "demand", 2, 1000, 0, 1000, &demand_)) return false;
  for (size_t i = 1; i < demand_.size(); ++i) {
    if (demand_[i] <= demand_[i - 1]) {
      mju_warning("plugin instance '%s': attribute 'demand' must increase; %g follows %g",
                  InstanceName(m, instance).c_str(), demand_[i], demand_[i - 1]);
      return false;
    }
  }
  const size_t count = kCircuits * demand_.size();
  return ReadNumbers(m, instance, "share_light", count, count, 0, 1, &light_) &&
         ReadNumbers(m, instance, "share_heavy", count, count, 0, 1, &heavy_);
}

void BrakeDistribution::Pressures(double friction, double shaft_force, double deceleration,
                                  double mass, double pressure[kCircuits]) const {
  double fraction;
  const size_t row = kCircuits * FindInterval(demand_, deceleration, &fraction);
  const double load = std::clamp((mass - mass_light_) / (mass_heavy_ - mass_light_), 0.0, 1.0);
  auto between = [fraction, row](const std::vector<double>& table, int i) {
    return table[row + i] + fraction * (table[row + kCircuits + i] - table[row + i]);
  };
  double share[kCircuits], sum = 0;
  for (int i = 0; i < kCircuits; ++i) {
    double light = between(light_, i), heavy = between(heavy_, i);
    share[i] = Present(i) ? light + load * (heavy - light) : 0;
    sum += share[i];
  }
  // What the shaft brakes is taken from the driven wheels' part of the whole.
  const double total = friction + std::max(0.0, shaft_force);
  if (sum > 0 && total > 0 && Present(kDrive)) {
    double spared = std::max(0.0, shaft_force) / total * sum;
    double left = std::max(0.0, share[kDrive] - spared);
    sum += left - share[kDrive];
    share[kDrive] = left;
  }
  for (int i = 0; i < kCircuits; ++i) {
    double force = sum > 0 ? friction * share[i] / sum : 0;
    pressure[i] = Present(i) ? push_out_pressure_ + force / slope_[i] : 0;
  }
}

}  // namespace iits
