// Steering plugin `iits.steering`. One actuator (control: steering-wheel angle [rad]) whose
// transmission is a fixed tendon over the left and the right knuckle joint of every steered axle.
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
        {"wheelbase",
         [&s](const mjModel* m, int instance, const char* name) {
           return ReadNumbers(m, instance, name, 1, kAxlesMax, -20, 20, &s.wheelbase) &&
                  (s.wheelbase[0] >= 0.5 ||
                   Refuse(m, instance, "attribute '%s' begins with %g; allowed are 0.5 to 20", name,
                          s.wheelbase[0]));
         }},
        Values("track", 0.1, 5, &s.track, {&s.wheelbase}),
    };
  }

  bool Bind(const mjModel* m, int instance) {
    if (!ReadAttributes(m, instance, Table())) return false;
    const std::vector<int> actuators = ActuatorsOfInstance(m, instance);
    if (actuators.size() != 1 || m->actuator_trntype[actuators[0]] != mjTRN_TENDON) {
      return Refuse(m, instance, "needs one actuator with a tendon over the knuckle joints");
    }
    actuator_ = actuators[0];
    const int tendon = m->actuator_trnid[2 * actuator_];
    const int begin = m->tendon_adr[tendon];
    for (int i = begin; i < begin + m->tendon_num[tendon]; ++i) {
      if (m->wrap_type[i] == mjWRAP_JOINT) joints_.push_back(m->wrap_objid[i]);
    }
    const size_t knuckles = 2 * law_.wheelbase.size();
    if (joints_.size() != knuckles || m->tendon_num[tendon] != static_cast<int>(knuckles)) {
      return Refuse(m, instance,
                    "its tendon must be fixed, over the left and right knuckle of each axle; "
                    "wheelbase has %zu axles, the tendon %zu joints",
                    law_.wheelbase.size(), joints_.size());
    }
    sensors_ = SensorsOfInstance(m, instance);
    return true;
  }

  // The linkage pulls each knuckle to its Ackermann angle.
  void Passive(const mjModel* m, mjData* d, const State* s) const {
    for (size_t i = 0; i < joints_.size(); i += 2) {
      double targets[2];
      law_.Targets(i / 2, s->now.pitman_angle, targets);
      for (size_t side : {0, 1}) {
        const int joint = joints_[i + side];
        const double angle = d->qpos[m->jnt_qposadr[joint]];
        d->qfrc_passive[m->jnt_dofadr[joint]] += law_.stiffness * (targets[side] - angle);
      }
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
  static constexpr size_t kAxlesMax = 8;

  Steering<double> law_;
  int actuator_ = -1;
  std::vector<int> joints_;  // knuckles, left and right of each axle
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
