// Fifth-wheel plugin `iits.fifth_wheel`, also for turntables, pintles and drawbar eyes. The towed
// unit's body references the instance; its three hinges are yaw (z), pitch (y), roll (x).
#include "plugin/laws/fifth_wheel.h"

#include "plugin/parts.h"
#include "plugin/plugin.h"

namespace iits {
namespace {

class FifthWheelPlugin : public PluginBase {
 public:
  using State = FifthWheelState;

  Attributes Table() {
    FifthWheel<double>& f = law_;
    return {
        Number("roll_stiffness", 0, 1e9, &f.roll_stiffness),
        Number("roll_damping", 0, 1e7, &f.roll_damping),
        Number("roll_lash", 0, 0.5, &f.roll_lash),
        Number("plate_width", 0, 3, &f.plate_width),
        Number("kingpin_load", 0, 1e6, &f.kingpin_load),
        Number("yaw_friction", 0, 1e6, &f.yaw_friction),
        Optional(Number("turntable", 0, 1, &f.turntable)),
    };
  }

  bool Bind(const mjModel* m, int instance) {
    if (!ReadAttributes(m, instance, Table())) return false;
    const std::vector<int> bodies = BodiesOfInstance(m, instance);
    if (bodies.size() != 1 || m->body_jntnum[bodies[0]] != 3) {
      return Refuse(m, instance, "one body with hinges yaw, pitch, roll must reference it");
    }
    yaw_ = m->body_jntadr[bodies[0]];
    roll_ = yaw_ + 2;
    return true;
  }

  void Passive(const mjModel* m, mjData* d, State* s) const {
    const int roll = m->jnt_dofadr[roll_], yaw = m->jnt_dofadr[yaw_];
    d->qfrc_passive[roll] += law_.RollMoment(d->qpos[m->jnt_qposadr[roll_]], d->qvel[roll]);
    s->next_wind_up = s->wind_up;
    d->qfrc_passive[yaw] += law_.YawMoment(d->qvel[yaw], m->opt.timestep, &s->next_wind_up);
  }

  void Advance(const mjModel*, mjData*, State* s) const { s->wind_up = s->next_wind_up; }

  const FifthWheel<double>* Law() const { return &law_; }

 private:
  FifthWheel<double> law_;
  int yaw_ = -1, roll_ = -1;  // joints
};

}  // namespace

const FifthWheel<double>* FifthWheelOf(const mjData* d, int instance) {
  return reinterpret_cast<const FifthWheelPlugin*>(d->plugin_data[instance])->Law();
}

void RegisterFifthWheel() {
  RegisterPlugin<FifthWheelPlugin>("iits.fifth_wheel", mjPLUGIN_PASSIVE);
}

}  // namespace iits
