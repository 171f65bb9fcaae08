// Steering plugin `iits.steering`: from steering wheel to road wheels.
#ifndef IITS_MJ_PLUGIN_STEERING_H_
#define IITS_MJ_PLUGIN_STEERING_H_

#include <mujoco/mujoco.h>

#include <vector>

namespace iits {

// One actuator (control: steering-wheel angle [rad]) whose transmission is a fixed tendon over the
// left and the right knuckle joint. Actuator lag and rate limit, play, Ackermann geometry, and the
// elastic steering linkage, which pulls each knuckle to its angle.
class Steering {
 public:
  struct State {
    double wheel_angle, pitman_angle;  // both at the steering wheel [rad]; pitman is after the play
    double next_wheel_angle, next_pitman_angle;
  };
  static constexpr int kStateSize = sizeof(State) / sizeof(mjtNum);

  static Steering* Create(const mjModel* m, int instance);  // null after a warning

  void Passive(const mjModel* m, mjData* d, int instance) const;
  void Actuator(const mjModel* m, mjData* d, int instance) const;
  void Sensors(const mjModel* m, mjData* d, int instance) const;
  void Advance(const mjModel* m, mjData* d, int instance) const;

 private:
  Steering() = default;

  int actuator_ = -1;
  int joint_left_ = -1, joint_right_ = -1;
  std::vector<int> sensors_;
  // Attributes, see README.md.
  double ratio_, dead_band_, angle_max_, rate_max_, stiffness_, time_constant_, wheelbase_, track_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_STEERING_H_
