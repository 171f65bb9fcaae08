// Registration of a plugin with MuJoCo, and look-up of the elements that belong to an instance.
#ifndef IITS_MJ_PLUGIN_PLUGIN_H_
#define IITS_MJ_PLUGIN_PLUGIN_H_

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "plugin/attributes.h"

namespace iits {

// Bodies that reference the plugin instance, in body order.
std::vector<int> BodiesOfInstance(const mjModel* m, int instance);

// Actuators that belong to the plugin instance, in actuator order.
std::vector<int> ActuatorsOfInstance(const mjModel* m, int instance);

// Sensors that belong to the plugin instance, in sensor order.
std::vector<int> SensorsOfInstance(const mjModel* m, int instance);

// Names of the elements of a plugin instance without the prefix and suffix that mjs_attach adds.
class LocalNames {
 public:
  // `anchor` is the local name of an actuator that each instance has; the actuator shows what was
  // added to the names.
  LocalNames(const mjModel* m, int instance, const char* anchor);

  // Local name of an element; its whole name, if that lacks the prefix or the suffix.
  std::string Of(const mjModel* m, mjtObj type, int id) const;

  // Whole name of the element with a local name.
  std::string Whole(const char* local) const { return prefix_ + local + suffix_; }

 private:
  std::string prefix_, suffix_;
};

// Stores the actuators of the plugin instance in `slots` by local name; slots without an actuator
// stay as they are. False after a warning for another name, or two actuators of one name.
bool FindActuatorsByName(const mjModel* m, int instance, const LocalNames& names,
                         const std::vector<std::pair<const char*, int*>>& slots);

// Degrees of freedom of the joints of an actuator's fixed tendon, with their coefficients.
std::vector<std::pair<int, double>> TendonDofs(const mjModel* m, int actuator);

// Instance of `plugin` that has the actuator of that whole name; -1 if there is none.
int PartnerInstance(const mjModel* m, const std::string& actuator, const char* plugin);

// Message that the partner committed at the end of the last step, so that the result does not
// depend on the order in which MuJoCo calls the plugins. It is the first member of the partner's
// state; all zero without a partner (instance < 0).
template <class Message>
Message ReadPartner(const mjModel* m, const mjData* d, int instance) {
  if (instance < 0) return Message();
  return *reinterpret_cast<const Message*>(d->plugin_state + m->plugin_stateadr[instance]);
}

// Control value clamped to its range; 0 without an actuator or if the value is not finite.
inline double Control(const mjModel* m, const mjData* d, int actuator, double low, double high) {
  if (actuator < 0) return 0;
  const double value = d->ctrl[m->actuator_ctrladr[actuator]];
  return std::isfinite(value) ? std::clamp(value, low, high) : 0;
}

// Base of the plugins, with default implementations. Objects hold constants; everything that
// evolves is in plugin_state, as a `State` of the plugin.
struct PluginBase {
  // Number of values of a sensor.
  static int SensorSize(const mjModel*, int /*instance*/, int /*sensor*/) { return 1; }
  // Number of `State`s of an instance.
  static int StateCount(const mjModel*, int /*instance*/) { return 1; }

  // The state is all zero when this is called.
  void Reset(void* /*state*/) const {}
  void Passive(const mjModel*, mjData*, void* /*state*/) const {}
  void Actuator(const mjModel*, mjData*, void* /*state*/) const {}
  void Sensors(const mjModel*, mjData*, void* /*state*/) const {}
  void Advance(const mjModel*, mjData*, void* /*state*/) const {}
};

// Registers the plugin `P`, a PluginBase with
//   struct State;                               members of type mjtNum; empty: no state
//   Attributes Table();                         its attributes, in MuJoCo's order
//   bool Bind(const mjModel* m, int instance);  reads them and finds its elements; false after a
//                                               warning
// and those of the functions above that `capabilities` require.
template <class P>
void RegisterPlugin(const char* name, int capabilities) {
  using State = typename P::State;
  static constexpr int kSize = std::is_empty_v<State> ? 0 : sizeof(State) / sizeof(mjtNum);
  static std::vector<const char*> names;
  P prototype;
  for (const Attribute& attribute : prototype.Table()) names.push_back(attribute.name);

  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = name;
  plugin.capabilityflags = capabilities;
  plugin.nattribute = static_cast<int>(names.size());
  plugin.attributes = names.data();
  // At mjSTAGE_VEL, MuJoCo would compute the velocities of all subtrees, which no sensor needs. The
  // accelerometers already compute the quantities of mjSTAGE_ACC.
  if (capabilities & mjPLUGIN_SENSOR) plugin.needstage = mjSTAGE_ACC;
  plugin.nstate =
      +[](const mjModel* m, int instance) { return kSize * P::StateCount(m, instance); };
  plugin.nsensordata = +[](const mjModel* m, int instance, int sensor) {
    return P::SensorSize(m, instance, sensor);
  };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    auto p = std::make_unique<P>();
    const bool bound = p->Bind(m, instance);
    d->plugin_data[instance] = bound ? reinterpret_cast<uintptr_t>(p.release()) : 0;
    return bound ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<P*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel* m, mjtNum* state, void* data, int instance) {
    mju_zero(state, m->plugin_statenum[instance]);
    reinterpret_cast<P*>(data)->Reset(reinterpret_cast<State*>(state));
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability) {
    // The plugin's object and state are those of the model for which the data were made.
    if (m->signature != d->signature) {
      mju_error("%s: mjData was made for another mjModel",
                mjp_getPluginAtSlot(m->plugin[instance])->name);
    }
    const P* p = reinterpret_cast<P*>(d->plugin_data[instance]);
    State* state = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
    if (capability & mjPLUGIN_PASSIVE) p->Passive(m, d, state);
    if (capability & mjPLUGIN_ACTUATOR) p->Actuator(m, d, state);
    if (capability & mjPLUGIN_SENSOR) p->Sensors(m, d, state);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    State* state = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
    reinterpret_cast<P*>(d->plugin_data[instance])->Advance(m, d, state);
  };
  mjp_registerPlugin(&plugin);
}

// One function per plugin, called when MuJoCo loads the library.
void RegisterAerodynamics();
void RegisterAirBrake();
void RegisterFifthWheel();
void RegisterPowertrain();
void RegisterSteering();
void RegisterTire();

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_PLUGIN_H_
