#include "plugin/registration.h"

#include <mujoco/mujoco.h>

#include <string>
#include <vector>

#include "plugin/config.h"

namespace iits {

std::vector<int> BodiesOfInstance(const mjModel* m, int instance) {
  std::vector<int> bodies;
  for (int i = 0; i < m->nbody; ++i) {
    if (m->body_plugin[i] == instance) bodies.push_back(i);
  }
  return bodies;
}

std::vector<int> ActuatorsOfInstance(const mjModel* m, int instance) {
  std::vector<int> actuators;
  // Since multi-input actuators, actuators are counted apart from controls (nu).
  for (int i = 0; i < m->nactuator; ++i) {
    if (m->actuator_plugin[i] == instance) actuators.push_back(i);
  }
  return actuators;
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
