// Steering plugin `iits.steering`. One actuator (control: steering-wheel angle [rad]) whose
// transmission is a fixed tendon over the left and the right knuckle joint.
#include "plugin/laws/steering.h"

#include "plugin/parts.h"
#include "plugin/plugin.h"

namespace iits {
namespace {

class SteeringPlugin : public PluginBase {
 public:
  using State = SteeringStates;

  Attributes Table() {
    Steering<double>& s = law_;
    return {
        Number("ratio", 1, 100, &s.ratio),
        Number("dead_band", 0, 1, &s.dead_band),
        Number("angle_max", 0.1, 100, &s.angle_max),
        Number("rate_max", 0.01, 1000, &s.rate_max),
        Number("stiffness", 1, 1e8, &s.stiffness),
        Number("time_constant", 0, 10, &s.time_constant),
        Number("wheelbase", 0.5, 20, &s.wheelbase),
        Number("track", 0.1, 5, &s.track),
    };
  }

  bool Bind(const mjModel* m, int instance) {
    if (!ReadAttributes(m, instance, Table())) return false;
    const std::vector<int> actuators = ActuatorsOfInstance(m, instance);
    if (actuators.size() != 1 || m->actuator_trntype[actuators[0]] != mjTRN_TENDON) {
      return Refuse(m, instance, "needs one actuator with a tendon over both knuckle joints");
    }
    actuator_ = actuators[0];
    const int tendon = m->actuator_trnid[2 * actuator_];
    const int wrap = m->tendon_adr[tendon];
    if (m->tendon_num[tendon] != 2 || m->wrap_type[wrap] != mjWRAP_JOINT ||
        m->wrap_type[wrap + 1] != mjWRAP_JOINT) {
      return Refuse(m, instance, "its tendon must be fixed, over the left and right knuckle");
    }
    for (int i = 0; i < 2; ++i) joints_[i] = m->wrap_objid[wrap + i];
    sensors_ = SensorsOfInstance(m, instance);
    return true;
  }

  // The linkage pulls each knuckle to its Ackermann angle.
  void Passive(const mjModel* m, mjData* d, const State* s) const {
    double targets[2];
    law_.Targets(s->now.pitman_angle, targets);
    for (int i = 0; i < 2; ++i) {
      const double angle = d->qpos[m->jnt_qposadr[joints_[i]]];
      d->qfrc_passive[m->jnt_dofadr[joints_[i]]] += law_.stiffness * (targets[i] - angle);
    }
  }

  void Actuator(const mjModel* m, mjData* d, State* s) const {
    s->next = law_.Step(d->ctrl[m->actuator_ctrladr[actuator_]], m->opt.timestep, s->now);
  }

  void Sensors(const mjModel* m, mjData* d, const State* s) const {
    for (int sensor : sensors_) d->sensordata[m->sensor_adr[sensor]] = s->now.wheel_angle;
  }

  void Advance(const mjModel*, mjData*, State* s) const { s->now = s->next; }

  const Steering<double>* Law() const { return &law_; }

 private:
  Steering<double> law_;
  int actuator_ = -1, joints_[2] = {-1, -1};
  std::vector<int> sensors_;
};

}  // namespace

const Steering<double>* SteeringOf(const mjData* d, int instance) {
  return reinterpret_cast<const SteeringPlugin*>(d->plugin_data[instance])->Law();
}

void RegisterSteering() {
  RegisterPlugin<SteeringPlugin>("iits.steering",
                                 mjPLUGIN_ACTUATOR | mjPLUGIN_PASSIVE | mjPLUGIN_SENSOR);
}

}  // namespace iits
