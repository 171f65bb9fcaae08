// Small helpers shared by the plugins: actuator and body look-up, force application.
#ifndef IITS_MJ_PLUGIN_REGISTRATION_H_
#define IITS_MJ_PLUGIN_REGISTRATION_H_

#include <mujoco/mujoco.h>

#include <vector>

namespace iits {

// Bodies that reference the plugin instance, in body order.
std::vector<int> BodiesOfInstance(const mjModel* m, int instance);

// Actuators that belong to the plugin instance, in actuator order.
std::vector<int> ActuatorsOfInstance(const mjModel* m, int instance);

// Velocity of the point `at` of body `body`, world frame: linear[3], angular[3].
inline void PointVelocity(const mjModel* m, const mjData* d, int body, const mjtNum at[3],
                          mjtNum linear[3], mjtNum angular[3]) {
  // cvel is (angular, linear) about the centre of mass of the kinematic tree's root.
  const mjtNum* cvel = d->cvel + 6 * body;
  const mjtNum* com = d->subtree_com + 3 * m->body_rootid[body];
  const mjtNum arm[3] = {at[0] - com[0], at[1] - com[1], at[2] - com[2]};
  angular[0] = cvel[0];
  angular[1] = cvel[1];
  angular[2] = cvel[2];
  linear[0] = cvel[3] + cvel[1] * arm[2] - cvel[2] * arm[1];
  linear[1] = cvel[4] + cvel[2] * arm[0] - cvel[0] * arm[2];
  linear[2] = cvel[5] + cvel[0] * arm[1] - cvel[1] * arm[0];
}

// Adds J' [force at `at`; torque] of body `body` to qfrc. Equals mj_applyFT, without its Jacobian.
inline void ApplyWrench(const mjModel* m, const mjData* d, int body, const mjtNum at[3],
                        const mjtNum force[3], const mjtNum torque[3], mjtNum* qfrc) {
  const mjtNum* com = d->subtree_com + 3 * m->body_rootid[body];
  const mjtNum arm[3] = {at[0] - com[0], at[1] - com[1], at[2] - com[2]};
  const mjtNum moment[3] = {torque[0] + arm[1] * force[2] - arm[2] * force[1],
                            torque[1] + arm[2] * force[0] - arm[0] * force[2],
                            torque[2] + arm[0] * force[1] - arm[1] * force[0]};
  while (body && !m->body_dofnum[body]) body = m->body_parentid[body];
  if (!body) return;
  for (int i = m->body_dofadr[body] + m->body_dofnum[body] - 1; i >= 0; i = m->dof_parentid[i]) {
    const mjtNum* cdof = d->cdof + 6 * i;
    qfrc[i] += cdof[0] * moment[0] + cdof[1] * moment[1] + cdof[2] * moment[2] +
               cdof[3] * force[0] + cdof[4] * force[1] + cdof[5] * force[2];
  }
}

// One function a plugin, called when MuJoCo loads the library.
void RegisterAerodynamics();
void RegisterAirBrake();
void RegisterFifthWheel();
void RegisterPowertrain();
void RegisterSteering();
void RegisterTire();

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_REGISTRATION_H_
