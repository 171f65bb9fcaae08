#include "plugin/reservoir.h"

#include <mujoco/mujoco.h>

#include <vector>

#include "plugin/config.h"

namespace iits {

bool Reservoirs::Read(const mjModel* m, int instance) {
  const Attribute attributes[] = {
      {"compressor_displacement", 0, 1, &displacement_},
      {"governor_cut_in", 0, 1e8, &cut_in_},
      {"governor_cut_out", 1, 1e8, &cut_out_},
      {"spring_begin_pressure", 1, 1e8, &spring_begin_},
      {"spring_full_pressure", 0, 1e8, &spring_full_},
  };
  if (!ReadAttributes(m, instance, attributes)) return false;
  if (cut_in_ >= cut_out_ || spring_full_ >= spring_begin_ || spring_begin_ >= cut_in_) {
    mju_warning(
        "plugin instance '%s': attributes must have spring_full_pressure < "
        "spring_begin_pressure < governor_cut_in < governor_cut_out; they are %g, %g, %g, %g",
        InstanceName(m, instance).c_str(), spring_full_, spring_begin_, cut_in_, cut_out_);
    return false;
  }
  std::vector<double> volume;
  if (!ReadNumbers(m, instance, "reservoir_volume", kCircuits, kCircuits, 1e-4, 100, &volume)) {
    return false;
  }
  std::copy(volume.begin(), volume.end(), volume_);
  return true;
}

}  // namespace iits
