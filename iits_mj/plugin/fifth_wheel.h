// Fifth-wheel plugin `iits.fifth_wheel`: roll stiffness after lash, friction of the greased plate.
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

  int yaw_ = -1, roll_ = -1;  // joints
  // Attributes, see README.md.
  double roll_stiffness_, roll_damping_, roll_lash_, yaw_friction_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_FIFTH_WHEEL_H_
