// Registration of the plugins, and look-up of what belongs to an instance.
#ifndef IITS_MJ_PLUGIN_REGISTRATION_H_
#define IITS_MJ_PLUGIN_REGISTRATION_H_

#include <mujoco/mujoco.h>

#include <vector>

namespace iits {

// Bodies that reference the plugin instance, in body order.
std::vector<int> BodiesOfInstance(const mjModel* m, int instance);

// Actuators that belong to the plugin instance, in actuator order.
std::vector<int> ActuatorsOfInstance(const mjModel* m, int instance);

// Instance of `plugin` that has an actuator under the same name prefix as `actuator`; -1 when there
// is none.
int PartnerInstance(const mjModel* m, int actuator, const char* plugin);

// One function a plugin, called when MuJoCo loads the library.
void RegisterAerodynamics();
void RegisterAirBrake();
void RegisterFifthWheel();
void RegisterPowertrain();
void RegisterSteering();
void RegisterTire();

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_REGISTRATION_H_
