#include "plugin/plugin.h"

#include <string>

namespace iits {
namespace {

std::vector<int> OfInstance(const int* plugin, int count, int instance) {
  std::vector<int> found;
  for (int i = 0; i < count; ++i) {
    if (plugin[i] == instance) found.push_back(i);
  }
  return found;
}

}  // namespace

std::vector<int> BodiesOfInstance(const mjModel* m, int instance) {
  return OfInstance(m->body_plugin, m->nbody, instance);
}

std::vector<int> ActuatorsOfInstance(const mjModel* m, int instance) {
  // Since multi-input actuators, actuators are counted apart from controls (nu).
  return OfInstance(m->actuator_plugin, m->nactuator, instance);
}

std::vector<int> SensorsOfInstance(const mjModel* m, int instance) {
  return OfInstance(m->sensor_plugin, m->nsensor, instance);
}

int PartnerInstance(const mjModel* m, int actuator, const char* plugin) {
  int slot = -1;
  if (!mjp_getPlugin(plugin, &slot)) return -1;
  const std::string prefix = NamePrefix(mj_id2name(m, mjOBJ_ACTUATOR, actuator));
  for (int i = 0; i < m->nactuator; ++i) {
    const int instance = m->actuator_plugin[i];
    if (instance < 0 || m->plugin[instance] != slot) continue;
    if (NamePrefix(mj_id2name(m, mjOBJ_ACTUATOR, i)) == prefix) return instance;
  }
  return -1;
}

}  // namespace iits

// MuJoCo version this library was compiled against; Python compares it and explains a mismatch.
extern "C" __attribute__((visibility("default"))) int iits_mj_compiled_version(void);
int iits_mj_compiled_version(void) { return mjVERSION_HEADER; }

mjPLUGIN_LIB_INIT(iits_mj) {
  // The plugin ABI holds for one exact version: register nothing rather than compute nonsense.
  if (mj_version() != mjVERSION_HEADER) {
    mju_warning("iits_mj plugin was built for MuJoCo %d but runs in %d: reinstall iits-mj",
                mjVERSION_HEADER, mj_version());
    return;
  }
  iits::RegisterAerodynamics();
  iits::RegisterAirBrake();
  iits::RegisterFifthWheel();
  iits::RegisterPowertrain();
  iits::RegisterSteering();
  iits::RegisterTire();
}
