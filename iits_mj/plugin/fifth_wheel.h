// Fifth-wheel plugin `iits.fifth_wheel`: roll moment of plate and lash, friction of the plate.
#ifndef IITS_MJ_PLUGIN_FIFTH_WHEEL_H_
#define IITS_MJ_PLUGIN_FIFTH_WHEEL_H_

#include <mujoco/mujoco.h>

namespace iits {

// The semitrailer's body references the instance; its three hinges are yaw (z), pitch (y), roll
// (x).
class FifthWheel {
 public:
  struct State {
    double wind_up, next_wind_up;  // of the plate's friction [rad]
  };
  static constexpr int kStateSize = sizeof(State) / sizeof(mjtNum);

  static FifthWheel* Create(const mjModel* m, int instance);  // null after a warning

  void Passive(const mjModel* m, mjData* d, int instance) const;
  void Advance(const mjModel* m, mjData* d, int instance) const;

 private:
  FifthWheel() = default;
  double RollMoment(double roll, double rate) const;

  int yaw_ = -1, roll_ = -1;  // joints
  // Attributes, see README.md.
  double roll_stiffness_, roll_damping_, roll_lash_, plate_width_, kingpin_load_, yaw_friction_;
  double lift_moment_ = 0;  // at which the plate opens [N m]
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_FIFTH_WHEEL_H_
