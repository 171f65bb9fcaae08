// An engine plugin with deliberate faults: `tools/sanitize.py` loads it to check that the
// sanitizers report faults of a plugin.
#include <mujoco/mujoco.h>

#include <climits>
#include <cstring>
#include <memory>

namespace {

int shared_by_threads = 0;
void* volatile last_leak = nullptr;

void Compute(const mjModel* m, mjData* d, int instance, int /*capability*/) {
  const char* bug = mj_getPluginConfig(m, instance, "bug");
  volatile int one = 1;
  if (!std::strcmp(bug, "overflow")) {
    auto values = std::make_unique<double[]>(4);
    volatile double* beyond = values.get() + 3 + one;
    *beyond = d->time;
  } else if (!std::strcmp(bug, "undefined")) {
    one = INT_MAX + one;
  } else if (!std::strcmp(bug, "leak")) {
    last_leak = new double[32];
    last_leak = nullptr;
  } else if (!std::strcmp(bug, "race")) {
    ++shared_by_threads;
  }
}

}  // namespace

mjPLUGIN_LIB_INIT(iits_mj_sanitizer_bugs) {
  static const char* attributes[] = {"bug"};
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.sanitizer_bugs";
  plugin.capabilityflags = mjPLUGIN_PASSIVE;
  plugin.nattribute = 1;
  plugin.attributes = attributes;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.init = +[](const mjModel*, mjData*, int) { return 0; };
  plugin.compute = Compute;
  mjp_registerPlugin(&plugin);
}
