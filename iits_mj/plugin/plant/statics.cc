// The truck at rest: loads of the axles, their change with pitch, and the inertia of the units.
#include <cmath>

#include "plugin/plant/vehicle.h"

namespace iits {
namespace {

// Solves a x = b in place by Cholesky's method; `a` is positive definite, row by row.
void Solve(std::vector<double> a, int n, std::vector<double>* b) {
  mju_cholFactor(a.data(), n, 0);
  mju_cholSolve(b->data(), a.data(), b->data(), n);
}

}  // namespace

// Axle loads per pitch moment of each unit, from the stiffness of tires, springs and the tendons
// that equalize loads. Coordinates: heave and pitch of the first unit, the pitch of the others
// about their couplings, the heave of each axle against its unit.
void Plant::SolvePitchGains(const mjModel* m) {
  const int units = static_cast<int>(units_.size()), axles = static_cast<int>(axles_.size());
  const int size = 1 + units + axles;
  std::vector<double> stiffness(size * size);
  auto add = [&stiffness, size](const std::vector<double>& row, double rate) {
    for (int i = 0; i < size; ++i) {
      for (int j = 0; j < size; ++j) stiffness[i * size + j] += rate * row[i] * row[j];
    }
  };
  std::vector<std::vector<double>> rows;
  std::vector<int> heave(m->njnt, -1);
  for (int a = 0; a < axles; ++a) {
    const Axle& axle = axles_[a];
    // Height of the axle: w = z - x theta on the first unit, hinged from unit to unit.
    std::vector<double> row(size);
    row[0] = 1;
    for (int u = 0; u < axle.unit; ++u) row[1 + u] = -units_[u].inertia.hitch_x;
    row[1 + axle.unit] = -axle.x;
    row[1 + units + a] = 1;
    const double rate = axle.rate;
    add(row, rate);
    for (double& value : row) value *= -rate;
    rows.push_back(row);
    const int joint = m->body_jntadr[m->jnt_bodyid[m->dof_jntid[axle.spin[0]]]];
    const int hub = m->body_parentid[m->jnt_bodyid[joint]];
    const int slide = m->body_jntadr[m->body_parentid[hub]];
    heave[slide] = a;
    std::vector<double> spring(size);
    spring[1 + units + a] = 1;
    // The small addition keeps an axle without spring definite.
    add(spring, m->jnt_stiffness[slide] + 1e-3 * rate);
  }
  for (int t = 0; t < m->ntendon; ++t) {
    if (m->tendon_stiffness[t] <= 0) continue;
    std::vector<double> row(size);
    for (int i = m->tendon_adr[t]; i < m->tendon_adr[t] + m->tendon_num[t]; ++i) {
      if (m->wrap_type[i] != mjWRAP_JOINT || heave[m->wrap_objid[i]] < 0) continue;
      row[1 + units + heave[m->wrap_objid[i]]] = m->wrap_prm[i];
    }
    add(row, m->tendon_stiffness[t]);
  }
  for (int u = 0; u < units; ++u) {
    std::vector<double> moved(size);
    moved[1 + u] = 1;
    Solve(stiffness, size, &moved);
    for (int a = 0; a < axles; ++a) {
      axles_[a].pitch_gain[u] = mju_dot(rows[a].data(), moved.data(), size);
    }
  }

  // At qpos0, the truck is nearly at rest; what is left moves it to its equilibrium. A hinge of
  // MuJoCo also turns the units behind.
  mj_fwdPosition(m, own_);
  mj_fwdVelocity(m, own_);
  auto force = [this](int dof) { return own_->qfrc_spring[dof] - own_->qfrc_bias[dof]; };
  std::vector<double> left(size);
  left[0] = force(lead_dof_ + 2);
  for (int u = 0; u < units; ++u) {
    left[1 + u] = force(u ? units_[u].yaw_dof + 1 : lead_dof_ + 4);
    if (u + 1 < units) left[1 + u] -= force(units_[u + 1].yaw_dof + 1);
  }
  for (int joint = 0; joint < m->njnt; ++joint) {
    if (heave[joint] >= 0) left[1 + units + heave[joint]] = force(m->jnt_dofadr[joint]);
  }
  for (int a = 0; a < axles; ++a) {
    if (axles_[a].rate == 0) continue;
    mju_addToScl(left.data(), rows[a].data(), -axles_[a].static_load / axles_[a].rate, size);
  }
  Solve(stiffness, size, &left);
  for (int a = 0; a < axles; ++a) {
    axles_[a].static_load += mju_dot(rows[a].data(), left.data(), size);
  }
}

// Sums over the bodies of each unit at rest.
void Plant::SumInertia(const mjModel* m) {
  const double gravity = mju_norm3(m->opt.gravity);
  const int units = static_cast<int>(units_.size());
  // Unit and axle of each body.
  std::vector<int> unit_of(m->nbody, -1), axle_of(m->nbody, -1);
  for (int u = 0; u < units; ++u) unit_of[units_[u].body] = u;
  for (size_t a = 0; a < axles_.size(); ++a) {
    const int wheel = m->dof_bodyid[axles_[a].spin[0]];
    axle_of[m->body_parentid[m->body_parentid[wheel]]] = static_cast<int>(a);
  }
  for (int body = 1; body < m->nbody; ++body) {
    const int parent = m->body_parentid[body];
    if (unit_of[body] < 0) unit_of[body] = unit_of[parent];
    if (axle_of[body] < 0) axle_of[body] = axle_of[parent];
  }
  for (int u = 0; u < units; ++u) {
    Unit& unit = units_[u];
    double carried = 0;
    for (int a = unit.first_axle; a < unit.end_axle; ++a) {
      carried += axles_[a].static_load;
      // Lateral forces act on the body at the roll centers, nearly in proportion to the loads.
      unit.roll_axis += axles_[a].static_load * axles_[a].roll_center;
    }
    unit.roll_axis /= carried;
    unit.coupling = u ? unit.front_height - unit.roll_axis : 0;
    PlanarInertia<double>* sum = &unit.inertia;
    sum->hitch_d = u + 1 < units ? unit.coupling - (unit.hitch_height - unit.roll_axis) : 0;
    double weight = 0;
    for (int body = 1; body < m->nbody; ++body) {
      if (unit_of[body] != u || m->body_mass[body] <= 0) continue;
      const double mass = m->body_mass[body];
      const mjtNum* at = own_->xipos + 3 * body;
      const double x = at[0] - own_->xpos[3 * unit.body], z = at[2];
      // Rotated to the world's axes.
      const mjtNum* frame = own_->ximat + 9 * body;
      const mjtNum* principal = m->body_inertia + 3 * body;
      double ixx = 0, izz = 0, ixz = 0;
      for (int k = 0; k < 3; ++k) {
        ixx += principal[k] * frame[k] * frame[k];
        izz += principal[k] * frame[6 + k] * frame[6 + k];
        ixz += principal[k] * frame[k] * frame[6 + k];
      }
      const double y = at[1];
      weight += mass * gravity;
      unit.pitch_inertia += mass * (z - unit.front_height);
      unit.pitch_product += mass * (z - unit.front_height) * x - ixz;
      sum->mass += mass;
      sum->x += mass * x;
      sum->xx += mass * (x * x + y * y) + izz;
      double lever = 0;  // above the roll axis; axles do not roll in the plane's equations
      if (axle_of[body] >= 0) {
        Axle& axle = axles_[axle_of[body]];
        axle.height = (axle.height * axle.mass + mass * z) / (axle.mass + mass);
        axle.mass += mass;
      } else {
        lever = z - unit.roll_axis;
        unit.sprung_x = (unit.sprung_x * unit.sprung_mass + mass * x) / (unit.sprung_mass + mass);
        unit.sprung_lever =
            (unit.sprung_lever * unit.sprung_mass + mass * lever) / (unit.sprung_mass + mass);
        unit.sprung_mass += mass;
        sum->xd += ixz;
        sum->dd += ixx + mass * y * y;
      }
      const double d = unit.coupling - lever;
      sum->d += mass * d;
      sum->xd += mass * x * d;
      sum->dd += mass * d * d;
    }
    unit.coupling_load = weight - carried;
  }
  // A unit's own coupling carries what its axles do not, and what the unit behind loads on it.
  for (int u = units - 1; u >= 0; --u) {
    Unit& unit = units_[u];
    const double behind = u + 1 < units ? units_[u + 1].coupling_load : 0;
    unit.coupling_load = u ? unit.coupling_load + behind : 0;
    unit.tilting = unit.sprung_mass * gravity * unit.sprung_lever +
                   behind * (unit.hitch_height - unit.roll_axis) -
                   unit.coupling_load * unit.coupling;
  }
}

}  // namespace iits
