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
  // An actuator may have several inputs: nactuator is not nu.
  return OfInstance(m->actuator_plugin, m->nactuator, instance);
}

std::vector<int> SensorsOfInstance(const mjModel* m, int instance) {
  return OfInstance(m->sensor_plugin, m->nsensor, instance);
}

bool FindActuatorsByName(const mjModel* m, int instance,
                         const std::vector<std::pair<const char*, int*>>& slots) {
  for (int i : ActuatorsOfInstance(m, instance)) {
    const std::string name = LocalName(mj_id2name(m, mjOBJ_ACTUATOR, i));
    std::string known;
    int* found = nullptr;
    for (const auto& [slot_name, slot] : slots) {
      known += std::string(known.empty() ? "" : ", ") + slot_name;
      if (name == slot_name) found = slot;
    }
    if (!found || *found >= 0) {
      return Refuse(m, instance, "actuator '%s' is not one of %s, each at most once", name.c_str(),
                    known.c_str());
    }
    *found = i;
  }
  return true;
}

std::vector<std::pair<int, double>> TendonDofs(const mjModel* m, int actuator) {
  std::vector<std::pair<int, double>> found;
  const int tendon = m->actuator_trnid[2 * actuator];
  const int begin = m->tendon_adr[tendon];
  for (int i = begin; i < begin + m->tendon_num[tendon]; ++i) {
    if (m->wrap_type[i] != mjWRAP_JOINT) continue;
    found.emplace_back(m->jnt_dofadr[m->wrap_objid[i]], m->wrap_prm[i]);
  }
  return found;
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

// MuJoCo version that the library was compiled against; Python compares it with its own.
extern "C" __attribute__((visibility("default"))) int iits_mj_compiled_version(void);
int iits_mj_compiled_version(void) { return mjVERSION_HEADER; }

mjPLUGIN_LIB_INIT(iits_mj) {
  // The plugin ABI is that of one exact version: do not register the plugins for any other.
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
