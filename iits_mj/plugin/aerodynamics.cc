#include "plugin/aerodynamics.h"

#include <mujoco/mujoco.h>

#include <cmath>
#include <memory>

#include "plugin/config.h"
#include "plugin/registration.h"
#include "plugin/spatial.h"

namespace iits {
namespace {

const char* const kAttributes[] = {"density", "drag_area", "side_area"};

}  // namespace

Aerodynamics* Aerodynamics::Create(const mjModel* m, int instance) {
  std::unique_ptr<Aerodynamics> a(new Aerodynamics());
  const Attribute attributes[] = {
      {"density", 0, 10, &a->density_},
      {"drag_area", 0, 100, &a->drag_area_},
      {"side_area", 0, 1000, &a->side_area_},
  };
  if (!ReadAttributes(m, instance, attributes)) return nullptr;
  a->bodies_ = BodiesOfInstance(m, instance);
  return a.release();
}

// F = 1/2 rho |v| v_i (C A)_i along the body's own x and y, v the air's relative velocity.
void Aerodynamics::Passive(const mjModel* m, mjData* d) const {
  const mjtNum no_torque[3] = {0, 0, 0};
  for (int body : bodies_) {
    const mjtNum* at = d->xpos + 3 * body;
    const mjtNum* mat = d->xmat + 9 * body;
    mjtNum v[3], angular[3];
    PointVelocity(m, d, body, at, v, angular);
    for (int i = 0; i < 3; ++i) v[i] -= m->opt.wind[i];
    double forward = v[0] * mat[0] + v[1] * mat[3] + v[2] * mat[6];
    double left = v[0] * mat[1] + v[1] * mat[4] + v[2] * mat[7];
    double speed = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    double drag = -0.5 * density_ * drag_area_ * speed * forward;
    double side = -0.5 * density_ * side_area_ * speed * left;
    mjtNum force[3];
    for (int i = 0; i < 3; ++i) force[i] = drag * mat[3 * i] + side * mat[3 * i + 1];
    Wrench wrench;
    wrench.Add(d->subtree_com + 3 * m->body_rootid[body], at, force, no_torque);
    wrench.Project(m, d, LastDof(m, body), -1, d->qfrc_passive);
  }
}

void RegisterAerodynamics() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.aerodynamics";
  plugin.capabilityflags = mjPLUGIN_PASSIVE;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.nstate = +[](const mjModel*, int) { return 0; };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    Aerodynamics* aerodynamics = Aerodynamics::Create(m, instance);
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(aerodynamics);
    return aerodynamics ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<Aerodynamics*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum*, void*, int) {};
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int) {
    reinterpret_cast<Aerodynamics*>(d->plugin_data[instance])->Passive(m, d);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace iits
