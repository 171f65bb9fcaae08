// Aerodynamics plugin `iits.aerodynamics`. Every body that references the instance is a center of
// pressure with its own axes; the wind is the model's `option/wind`, to
// which `mean_wind` adds one from all directions.
#include "plugin/laws/aerodynamics.h"

#include "plugin/parts.h"
#include "plugin/plugin.h"
#include "plugin/spatial.h"

namespace iits {
namespace {

class AerodynamicsPlugin : public PluginBase {
 public:
  struct State {};

  Attributes Table() {
    return {
        Number("density", 0, 10, &law_.density),
        Number("drag_area", 0, 100, &law_.drag_area),
        Number("side_area", 0, 1000, &law_.side_area),
        Optional(Ordered("drag_yaw_angle", 1, 2, 64, 0, 1.5, &law_.increase.x)),
        Together("drag_yaw_angle",
                 Values("drag_area_increase", -100, 100, &law_.increase.y, {&law_.increase.x})),
        Optional(Number("mean_wind", 0, 40, &law_.mean_wind)),
    };
  }

  bool Bind(const mjModel* m, int instance) {
    bodies_ = BodiesOfInstance(m, instance);
    if (!ReadAttributes(m, instance, Table())) return false;
    law_.Prepare();
    return true;
  }

  void Passive(const mjModel* m, mjData* d, const State*) const {
    const mjtNum no_torque[3] = {0, 0, 0};
    for (int body : bodies_) {
      const mjtNum* at = d->xpos + 3 * body;
      const mjtNum* mat = d->xmat + 9 * body;
      mjtNum v[3], angular[3], along[2], force[3];
      PointVelocity(m, d, body, at, v, angular);
      for (int i = 0; i < 3; ++i) v[i] -= m->opt.wind[i];
      const mjtNum forward = v[0] * mat[0] + v[1] * mat[3] + v[2] * mat[6];
      const mjtNum left = v[0] * mat[1] + v[1] * mat[4] + v[2] * mat[7];
      law_.Force(sqrt(Dot(v, v)), forward, left, along);
      for (int i = 0; i < 3; ++i) force[i] = along[0] * mat[3 * i] + along[1] * mat[3 * i + 1];
      Wrench wrench;
      wrench.Add(d->subtree_com + 3 * m->body_rootid[body], at, force, no_torque);
      wrench.Project(m, d, LastDof(m, body), -1, d->qfrc_passive);
    }
  }

  const Aerodynamics<double>* Law() const { return &law_; }

 private:
  Aerodynamics<double> law_;
  std::vector<int> bodies_;
};

}  // namespace

const Aerodynamics<double>* AerodynamicsOf(const mjData* d, int instance) {
  return reinterpret_cast<const AerodynamicsPlugin*>(d->plugin_data[instance])->Law();
}

void RegisterAerodynamics() {
  RegisterPlugin<AerodynamicsPlugin>("iits.aerodynamics", mjPLUGIN_PASSIVE);
}

}  // namespace iits
