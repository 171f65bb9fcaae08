// Steering plugin `iits.steering`. One actuator (control: steering-wheel angle [rad]) whose
// transmission is a fixed tendon over the left and the right knuckle joint of every steered axle.
#include "plugin/laws/steering.h"

#include <algorithm>
#include <cstring>

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
        Optional(Number("caster_trail", -0.5, 0.5, &s.caster_trail)),
        Optional(Number("scrub_radius", -0.5, 0.5, &s.scrub_radius)),
        Optional(Number("kingpin_inclination", -0.5, 0.5, &s.kingpin_inclination)),
        Optional(Number("scrub_friction", 0, 2, &s.scrub_friction)),
        Optional(Number("scrub_arm", 0, 1, &s.scrub_arm)),
        Optional(Number("friction", 0, 100, &s.friction)),
        Optional(Ordered("boost_torque", 1, 2, 64, 0, 100, &s.assistance.x)),
        Together("boost_torque", Ordered("boost_assistance", 1, 2, 64, 0, 1e5, &s.assistance.y)),
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
    for (int sensor : SensorsOfInstance(m, instance)) {
      const bool torque =
          std::strstr(m->names + m->name_sensoradr[sensor], "steering_wheel_torque");
      (torque ? torque_sensors_ : sensors_).push_back(sensor);
    }
    return CheckBoost(m, instance) && (torque_sensors_.empty() || FindWheels(m, instance));
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
    for (int sensor : torque_sensors_) d->sensordata[m->sensor_adr[sensor]] = WheelTorque(m, d, *s);
  }

  void Advance(const mjModel*, mjData*, State* s) const { s->now = s->next; }

  const Steering<double>* Law() const { return &law_; }

 private:
  static constexpr size_t kAxlesMax = 8;

  // A steered wheel: its spin, its tire's radius and state.
  struct Wheel {
    int dof;
    double radius;
    int state;  // in plugin_state
  };

  bool CheckBoost(const mjModel* m, int instance) const {
    const Curve<double>& boost = law_.assistance;
    const bool from_zero = boost.x.empty() || (boost.x[0] == 0 && boost.y[0] == 0);
    return (boost.x.size() == boost.y.size() && from_zero) ||
           Refuse(m, instance,
                  "boost_torque (%zu numbers) and boost_assistance (%zu) must have equally many, "
                  "which begin with 0",
                  boost.x.size(), boost.y.size());
  }

  // The wheel of each knuckle, a body with a tire below the knuckle's.
  bool FindWheels(const mjModel* m, int instance) {
    for (int joint : joints_) {
      const size_t found = wheels_.size();
      for (int body = 0; body < m->nbody && wheels_.size() == found; ++body) {
        const int tire = m->body_parentid[body] == m->jnt_bodyid[joint] ? m->body_plugin[body] : -1;
        if (tire < 0 || std::strcmp(mjp_getPluginAtSlot(m->plugin[tire])->name, "iits.tire")) {
          continue;
        }
        const std::vector<int> bodies = BodiesOfInstance(m, tire);
        const auto place = std::find(bodies.begin(), bodies.end(), body) - bodies.begin();
        constexpr int kSize = sizeof(TireState) / sizeof(mjtNum);
        const double radius = std::atof(mj_getPluginConfig(m, tire, "rolling_radius"));
        wheels_.push_back({m->jnt_dofadr[m->body_jntadr[body]], radius,
                           m->plugin_stateadr[tire] + kSize * static_cast<int>(place)});
      }
      if (wheels_.size() == found) {
        return Refuse(m, instance,
                      "the sensor steering_wheel_torque needs a wheel with iits.tire "
                      "on the knuckle of joint '%s'",
                      m->names + m->name_jntadr[joint]);
      }
    }
    return true;
  }

  // From the forces of the tires at this moment.
  double WheelTorque(const mjModel* m, const mjData* d, const State& s) const {
    double load = 0;
    for (size_t i = 0; i < joints_.size(); ++i) {
      double leverage[2];
      law_.Leverage(i / 2, s.now.pitman_angle, leverage);
      const auto* tire = reinterpret_cast<const TireState*>(d->plugin_state + wheels_[i].state);
      const double* of = tire->signal;
      const KingpinLoad<double> at = {of[0],
                                      of[1],
                                      of[2],
                                      of[3],
                                      d->qpos[m->jnt_qposadr[joints_[i]]],
                                      d->qvel[m->jnt_dofadr[joints_[i]]],
                                      wheels_[i].radius * d->qvel[wheels_[i].dof],
                                      i % 2 ? -1.0 : 1.0};
      load -= leverage[i % 2] * law_.KingpinMoment(at);
    }
    return law_.WheelTorque(load, (s.next.wheel_angle - s.now.wheel_angle) / m->opt.timestep);
  }

  Steering<double> law_;
  int actuator_ = -1;
  std::vector<int> joints_;  // knuckles, left and right of each axle
  std::vector<int> sensors_, torque_sensors_;
  std::vector<Wheel> wheels_;  // of the joints, if there is a sensor of the torque
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
