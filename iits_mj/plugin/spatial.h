// Velocities and forces of bodies in MuJoCo's coordinates: world axes, about the center of mass of
// the kinematic tree.
#ifndef IITS_MJ_PLUGIN_SPATIAL_H_
#define IITS_MJ_PLUGIN_SPATIAL_H_

#include <mujoco/mujoco.h>

#include <cstring>

#include "plugin/laws/number.h"

namespace iits {

// Velocity of the point `at` of body `body`, world frame: linear[3], angular[3].
inline void PointVelocity(const mjModel* m, const mjData* d, int body, const mjtNum at[3],
                          mjtNum linear[3], mjtNum angular[3]) {
  // cvel is (angular, linear) about the center of mass of the kinematic tree's root.
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

// Moment about the center of mass of the whole kinematic tree, and force; wrenches on bodies of one
// tree add up.
struct Wrench {
  mjtNum moment[3] = {0, 0, 0};
  mjtNum force[3] = {0, 0, 0};

  // Adds `f` at the point `at` and the torque `t`; `com` is the tree's subtree_com.
  void Add(const mjtNum com[3], const mjtNum at[3], const mjtNum f[3], const mjtNum t[3]) {
    const mjtNum arm[3] = {at[0] - com[0], at[1] - com[1], at[2] - com[2]};
    moment[0] += t[0] + arm[1] * f[2] - arm[2] * f[1];
    moment[1] += t[1] + arm[2] * f[0] - arm[0] * f[2];
    moment[2] += t[2] + arm[0] * f[1] - arm[1] * f[0];
    for (int i = 0; i < 3; ++i) force[i] += f[i];
  }

  void Add(const Wrench& other) {
    for (int i = 0; i < 3; ++i) {
      moment[i] += other.moment[i];
      force[i] += other.force[i];
    }
  }

  // Adds J' w to qfrc for the degrees of freedom from `dof` towards the root, until `stop`, which
  // is excluded (-1: all).
  void Project(const mjModel* m, const mjData* d, int dof, int stop, mjtNum* qfrc) const {
    const Pair w[3] = {{moment[0], moment[1]}, {moment[2], force[0]}, {force[1], force[2]}};
    for (int i = dof; i != stop; i = m->dof_parentid[i]) {
      Pair c[3];  // two products at a time
      std::memcpy(c, d->cdof + 6 * i, sizeof(c));
      const Pair sum = c[0] * w[0] + c[1] * w[1] + c[2] * w[2];
      qfrc[i] += sum[0] + sum[1];
    }
  }
};

// Last degree of freedom that moves the body; -1 if there is none.
inline int LastDof(const mjModel* m, int body) {
  while (body && !m->body_dofnum[body]) body = m->body_parentid[body];
  return body ? m->body_dofadr[body] + m->body_dofnum[body] - 1 : -1;
}

// Last degree of freedom that two chains have in common; -1 if there is none.
inline int CommonDof(const mjModel* m, int a, int b) {
  while (a != b) {  // a parent always has the smaller index
    int& later = a > b ? a : b;
    later = m->dof_parentid[later];
  }
  return a;
}

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_SPATIAL_H_
