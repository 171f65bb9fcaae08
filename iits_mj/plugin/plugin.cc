#include "plugin/plugin.h"

#include <cstring>
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

LocalNames::LocalNames(const mjModel* m, int instance, const char* anchor) {
  for (int i : ActuatorsOfInstance(m, instance)) {
    const char* name = mj_id2name(m, mjOBJ_ACTUATOR, i);
    const std::string whole = name ? name : "";
    const size_t at = whole.rfind(anchor);
    if (at == std::string::npos) continue;
    prefix_ = whole.substr(0, at);
    suffix_ = whole.substr(at + std::strlen(anchor));
    return;
  }
}

std::string LocalNames::Of(const mjModel* m, mjtObj type, int id) const {
  const char* name = mj_id2name(m, type, id);
  const std::string whole = name ? name : "";
  const size_t added = prefix_.size() + suffix_.size();
  if (whole.size() < added || whole.compare(0, prefix_.size(), prefix_) ||
      whole.compare(whole.size() - suffix_.size(), suffix_.size(), suffix_)) {
    return whole;
  }
  return whole.substr(prefix_.size(), whole.size() - added);
}

bool FindActuatorsByName(const mjModel* m, int instance, const LocalNames& names,
                         const std::vector<std::pair<const char*, int*>>& slots) {
  for (int i : ActuatorsOfInstance(m, instance)) {
    const std::string name = names.Of(m, mjOBJ_ACTUATOR, i);
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

int PartnerInstance(const mjModel* m, const std::string& actuator, const char* plugin) {
  int slot = -1;
  if (!mjp_getPlugin(plugin, &slot)) return -1;
  const int id = mj_name2id(m, mjOBJ_ACTUATOR, actuator.c_str());
  const int instance = id < 0 ? -1 : m->actuator_plugin[id];
  return instance >= 0 && m->plugin[instance] == slot ? instance : -1;
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
