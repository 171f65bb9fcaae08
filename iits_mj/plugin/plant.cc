// The planar plant, built from the truck's compiled model; see the manual README_plant.md.
#include "plugin/plant.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "plugin/plugin.h"

namespace iits {
namespace {

constexpr double kLoadLag = 0.1;        // [s] of the load transfer that has no state
constexpr double kStopStiffness = 2e6;  // [N m/rad] of a coupling's stop in yaw, estimated
constexpr double kStopDamping = 1e5;    // [N m s/rad]
constexpr double kRollMax = 0.17;       // [rad] up to which roll counts as small
constexpr int kNoJoint = -1;

bool IsPlugin(const mjModel* m, int instance, const char* name) {
  int slot = -1;
  return instance >= 0 && mjp_getPlugin(name, &slot) && m->plugin[instance] == slot;
}

// Solves a x = b in place by Cholesky's method; `a` is positive definite, row by row.
void Solve(std::vector<double> a, int n, std::vector<double>* b) {
  mju_cholFactor(a.data(), n, 0);
  mju_cholSolve(b->data(), a.data(), b->data(), n);
}

}  // namespace

struct Plant::Axle {
  int unit;
  double x, half_track;
  double static_load;  // of the axle on a level road [N]
  double rate;         // of its tires [N/m]; 0 for a lifted axle
  const Tire<double>* law;
  int state[2], spin[2], hub[2];  // addresses of the wheels in plugin_state, qvel; hub's number
  int spin_qpos[2];
  Pair carry;
  double inverse_inertia[2], shaft[2];  // of the spin; torque per torque of the propeller shaft
  bool steered = false;
  int knuckle_qpos[2] = {0, 0}, knuckle[2] = {kNoJoint, kNoJoint};
  double knuckle_inertia = 0, knuckle_damping = 0, knuckle_stiffness = 0, knuckle_max = 0;
  int target = -1;  // place among the axles that the steering's linkage turns
  int roll_qpos = kNoJoint;
  double roll_stiffness, roll_damping, tire_roll_stiffness;  // about the roll center, on the road
  double share;                      // of the spring in series with the tires
  double roll_center, mass, height;  // heights above the road [m]; mass without the sprung one
  double pitch_gain[kUnitsMax];      // load [N] per pitch moment of each unit [N m]
};

struct Plant::Unit {
  int body;
  PlanarInertia<double> inertia;
  double coupling;       // lever c of the front coupling above the roll axis [m]
  double roll_axis;      // height above the road [m]
  double hitch_height;   // of the next unit's coupling above the road [m]
  double front_height;   // of the own coupling, 0 of the first unit [m]
  double pitch_inertia;  // sum of m (z - front_height) [kg m]
  double pitch_product;  // sum of m (z - front_height) x, with the bodies' own [kg m2]
  double sprung_mass, sprung_x, sprung_lever;  // lever: height of its CG above the roll axis [m]
  double tilting;        // roll moment of the weights per roll angle [N m/rad]
  double coupling_load;  // vertical load on the coupling [N]
  int first_axle, end_axle;
  // Fifth wheel.
  const FifthWheel<double>* law = nullptr;
  int law_state = 0, yaw_qpos = 0, yaw_dof = 0;
  bool limited = false;
  double yaw_min = 0, yaw_max = 0;
  // Pressure centers.
  struct Air {
    const Aerodynamics<double>* law;
    double x, height;
  };
  std::vector<Air> air;
};

// Intermediate values of a step; every step overwrites them.
struct Plant::Scratch {
  PlanarMotion<double> motion[kUnitsMax];
  double cosine[kUnitsMax], sine[kUnitsMax], x[kUnitsMax], y[kUnitsMax];
  PlanarVector<double> force[kUnitsMax];
  double hitch[kUnitsMax][2];
  double air_roll[kUnitsMax];       // moment about the roll axis
  double tilt[kUnitsMax];           // of the road below the axles, left side up [rad]
  double coupling_roll[kUnitsMax];  // moment of the coupling about the unit's own x axis
  double lateral[kPlantAxlesMax], overturning[kPlantAxlesMax];  // of an axle's tires
};

Plant::Plant(const mjModel* m, const std::string& prefix, bool rolls, std::string* error)
    : rolls_(rolls), own_(mj_makeData(m)) {
  mj_kinematics(m, own_);
  mj_comPos(m, own_);
  if (!FindUnits(m, prefix, error) || !FindAxles(m, error) || !FindPlugins(m, prefix, error)) {
    return;
  }
  FindPitchGains(m);
  FindInertia(m);
  for (const Unit& unit : units_) inertia_.push_back(unit.inertia);
}

Plant::~Plant() { mj_deleteData(own_); }

bool Plant::FindUnits(const mjModel* m, const std::string& prefix, std::string* error) {
  const int demand = mj_name2id(m, mjOBJ_ACTUATOR, (prefix + "xbr_demand").c_str());
  brake_instance_ = demand < 0 ? -1 : m->actuator_plugin[demand];
  if (!IsPlugin(m, brake_instance_, "iits.air_brake")) {
    *error = "the model has no actuator '" + prefix + "xbr_demand' of an iits.air_brake";
    return false;
  }
  const int root = m->body_rootid[BodiesOfInstance(m, brake_instance_)[0]];
  const int joint = m->body_jntadr[root];
  if (joint < 0 || m->jnt_type[joint] != mjJNT_FREE) {
    *error = "the truck's first unit must have a free joint";
    return false;
  }
  lead_qpos_ = m->jnt_qposadr[joint];
  lead_dof_ = m->jnt_dofadr[joint];
  for (int body = root; body < m->nbody; ++body) {
    if (m->body_rootid[body] != root) continue;
    const bool towed = IsPlugin(m, m->body_plugin[body], "iits.fifth_wheel");
    if (body != root && !towed) continue;
    Unit unit = {};
    unit.body = body;
    if (towed) {
      const int ahead = m->body_parentid[body];
      if (static_cast<int>(units_.size()) == kUnitsMax || ahead != units_.back().body) {
        *error = "the units must form a chain of at most " + std::to_string(kUnitsMax) +
                 ": body '" + (m->names + m->name_bodyadr[body]) + "'";
        return false;
      }
      const int instance = m->body_plugin[body], yaw = m->body_jntadr[body];
      unit.law = FifthWheelOf(own_, instance);
      unit.law_state = m->plugin_stateadr[instance];
      unit.yaw_qpos = m->jnt_qposadr[yaw];
      unit.yaw_dof = m->jnt_dofadr[yaw];
      unit.limited = m->jnt_limited[yaw];
      unit.yaw_min = m->jnt_range[2 * yaw];
      unit.yaw_max = m->jnt_range[2 * yaw + 1];
      units_.back().hitch_height = own_->xpos[3 * body + 2];
      units_.back().inertia.hitch_x = own_->xpos[3 * body] - own_->xpos[3 * units_.back().body];
      unit.front_height = own_->xpos[3 * body + 2];
    }
    units_.push_back(unit);
  }
  return true;
}

// An axle is a body with a slide (heave) and a hinge (roll), two hubs, and a wheel on each.
bool Plant::FindAxles(const mjModel* m, std::string* error) {
  const std::vector<int> hubs = BodiesOfInstance(m, brake_instance_);
  for (size_t k = 0; k + 1 < hubs.size(); k += 2) {
    Axle axle = {};
    const int body = m->body_parentid[hubs[k]];
    auto unit = std::find_if(units_.begin(), units_.end(),
                             [m, body](const Unit& u) { return u.body == m->body_parentid[body]; });
    if (unit == units_.end() || m->body_jntnum[body] != 2 || axles_.size() == kPlantAxlesMax) {
      *error = "body '" + std::string(m->names + m->name_bodyadr[body]) +
               "' is no axle of a unit, with the joints heave and roll";
      return false;
    }
    axle.unit = static_cast<int>(unit - units_.begin());
    axle.x = own_->xpos[3 * body] - own_->xpos[3 * unit->body];
    axle.half_track = std::abs(own_->xpos[3 * hubs[k] + 1]);
    const int roll = m->body_jntadr[body] + 1;
    axle.roll_qpos = m->jnt_qposadr[roll];
    axle.roll_stiffness = m->jnt_stiffness[roll];
    axle.roll_damping = m->dof_damping[m->jnt_dofadr[roll]];
    axle.roll_center = own_->xpos[3 * body + 2] + m->jnt_pos[3 * roll + 2];
    for (int side = 0; side < 2; ++side) {
      const int hub = hubs[k + side];
      int wheel = hub + 1;
      while (wheel < m->nbody && m->body_parentid[wheel] != hub) ++wheel;
      const int instance = wheel < m->nbody ? m->body_plugin[wheel] : -1;
      if (!IsPlugin(m, instance, "iits.tire")) {
        *error = "hub '" + std::string(m->names + m->name_bodyadr[hub]) + "' has no tire";
        return false;
      }
      const TirePart tire = TireOf(own_, instance);
      axle.law = tire.law;
      road_ = tire.road;
      road_address_ = tire.road_address;
      const std::vector<int> wheels = BodiesOfInstance(m, instance);
      const auto number = std::find(wheels.begin(), wheels.end(), wheel) - wheels.begin();
      axle.state[side] = m->plugin_stateadr[instance] +
                         static_cast<int>(number * (sizeof(TireState) / sizeof(mjtNum)));
      const int spin = m->body_jntadr[wheel];
      axle.spin[side] = m->jnt_dofadr[spin];
      axle.spin_qpos[side] = m->jnt_qposadr[spin];
      axle.inverse_inertia[side] = 1 / m->dof_M0[axle.spin[side]];
      axle.carry[side] = axle.law->Carry(m->dof_M0[axle.spin[side]]);
      axle.hub[side] = static_cast<int>(k) + side;
      if (m->body_jntnum[hub] > 0) {
        const int knuckle = m->body_jntadr[hub], dof = m->jnt_dofadr[knuckle];
        axle.steered = true;
        axle.knuckle_qpos[side] = m->jnt_qposadr[knuckle];
        axle.knuckle[side] = dof;
        axle.knuckle_inertia = m->dof_M0[dof];
        axle.knuckle_damping = m->dof_damping[dof];
        axle.knuckle_stiffness = m->jnt_stiffness[knuckle];
        axle.knuckle_max = m->jnt_limited[knuckle] ? m->jnt_range[2 * knuckle + 1] : mjPI;
      }
      const double deflection = axle.law->free_radius - own_->xpos[3 * wheel + 2];
      axle.static_load += axle.law->count * axle.law->vertical_stiffness * deflection;
    }
    if (axle.static_load < 0) {  // lifted
      axle.static_load = axle.rate = 0;
    } else {
      axle.rate = 2 * axle.law->count * axle.law->vertical_stiffness;
    }
    axle.tire_roll_stiffness = axle.rate * axle.half_track * axle.half_track;
    axle.share = axle.tire_roll_stiffness / (axle.tire_roll_stiffness + axle.roll_stiffness);
    axles_.push_back(axle);
  }
  // Axles of a unit are adjacent, because the bodies are in tree order.
  std::stable_sort(axles_.begin(), axles_.end(),
                   [](const Axle& a, const Axle& b) { return a.unit < b.unit; });
  for (size_t u = 0; u < units_.size(); ++u) {
    auto of = [u](const Axle& a) { return a.unit == static_cast<int>(u); };
    units_[u].first_axle =
        static_cast<int>(std::find_if(axles_.begin(), axles_.end(), of) - axles_.begin());
    units_[u].end_axle =
        units_[u].first_axle + static_cast<int>(std::count_if(axles_.begin(), axles_.end(), of));
    if (units_[u].first_axle == units_[u].end_axle) {
      *error = "unit '" + std::string(m->names + m->name_bodyadr[units_[u].body]) + "' has no axle";
      return false;
    }
  }
  return true;
}

bool Plant::FindPlugins(const mjModel* m, const std::string& prefix, std::string* error) {
  auto instance = [m, &prefix](const char* actuator, const char* plugin) {
    return PartnerInstance(m, prefix + actuator, plugin);
  };
  powertrain_instance_ = instance("accelerator_pedal", "iits.powertrain");
  steering_instance_ = instance("steering_wheel_angle", "iits.steering");
  if (powertrain_instance_ < 0 || steering_instance_ < 0) {
    *error = "the model lacks an actuator accelerator_pedal or steering_wheel_angle";
    return false;
  }
  auto plugin = [m](int i) { return mjp_getPluginAtSlot(m->plugin[i]); };
  powertrain_plugin_ = plugin(powertrain_instance_);
  steering_plugin_ = plugin(steering_instance_);
  brake_plugin_ = plugin(brake_instance_);
  steering_ = SteeringOf(own_, steering_instance_);

  const int pedal = mj_name2id(m, mjOBJ_ACTUATOR, (prefix + "accelerator_pedal").c_str());
  const int linkage = mj_name2id(m, mjOBJ_ACTUATOR, (prefix + "steering_wheel_angle").c_str());
  shaft_force_ = m->actuator_outadr[pedal];
  for (const auto& [dof, coefficient] : TendonDofs(m, pedal)) {
    for (Axle& axle : axles_) {
      for (int side = 0; side < 2; ++side) {
        if (axle.spin[side] == dof) axle.shaft[side] = m->actuator_gear[6 * pedal] * coefficient;
      }
    }
  }
  // The linkage holds the left and the right knuckle of each steered axle.
  const auto knuckles = TendonDofs(m, linkage);
  for (size_t i = 0; i < knuckles.size(); i += 2) {
    for (Axle& axle : axles_) {
      if (axle.knuckle[0] == knuckles[i].first) axle.target = static_cast<int>(i / 2);
    }
  }
  for (Axle& axle : axles_) {
    if (axle.target >= 0) axle.knuckle_stiffness += steering_->stiffness;
  }
  for (int body = 0; body < m->nbody; ++body) {
    if (!IsPlugin(m, m->body_plugin[body], "iits.aerodynamics")) continue;
    for (Unit& unit : units_) {
      if (m->body_parentid[body] != unit.body) continue;
      unit.air.push_back({AerodynamicsOf(own_, m->body_plugin[body]),
                          own_->xpos[3 * body] - own_->xpos[3 * unit.body],
                          own_->xpos[3 * body + 2]});
    }
  }
  return true;
}

// Axle loads per pitch moment of each unit, from the stiffness of tires, springs and the tendons
// that equalize loads. Coordinates: heave and pitch of the first unit, the pitch of the others
// about their couplings, the heave of each axle against its unit.
void Plant::FindPitchGains(const mjModel* m) {
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
void Plant::FindInertia(const mjModel* m) {
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

PlantState* Plant::State(const mjModel* m, mjData* d) const {
  // The last part of the user's data, so that a user's own come first.
  return reinterpret_cast<PlantState*>(d->userdata + m->nuserdata) - 1;
}

void Plant::Remember(const mjModel*, const mjData* d, double* seen) const {
  std::memcpy(seen, d->qpos + lead_qpos_, 7 * sizeof(double));
  std::memcpy(seen + 7, d->qvel + lead_dof_, 6 * sizeof(double));
  seen += 13;
  for (size_t u = 1; u < units_.size(); ++u, seen += 6) {
    std::memcpy(seen, d->qpos + units_[u].yaw_qpos, 3 * sizeof(double));
    std::memcpy(seen + 3, d->qvel + units_[u].yaw_dof, 3 * sizeof(double));
  }
}

// Reads the state from qpos and qvel.
void Plant::Adopt(const mjModel* m, mjData* d, PlantState* s) const {
  mj_kinematics(m, d);
  const mjtNum* velocity = d->qvel + lead_dof_;
  double yaw_rate = velocity[5], roll_rate = rolls_ ? velocity[3] : 0;
  for (size_t u = 0; u < units_.size(); ++u) {
    const Unit& unit = units_[u];
    const mjtNum* frame = d->xmat + 9 * unit.body;
    const mjtNum* at = d->xpos + 3 * unit.body;
    PlantState::Unit* to = &s->unit[u];
    if (u) {
      to->articulation = d->qpos[unit.yaw_qpos];
      yaw_rate += d->qvel[unit.yaw_dof];
      if (rolls_) {
        roll_rate = roll_rate * std::cos(to->articulation) + d->qvel[unit.yaw_dof + 2];
      }
    }
    to->yaw_rate = yaw_rate;
    to->roll_rate = roll_rate;
    to->roll = 0;
    if (rolls_) {
      const double x = at[0] + frame[0] * axles_[unit.first_axle].x;
      const double y = at[1] + frame[3] * axles_[unit.first_axle].x;
      const RoadPoint<double> road =
          road_.Evaluate(m->numeric_data + road_address_, x, y, RoadTable::kUnknownStation);
      const double left =
          road.norm * (road.up[0] * frame[1] + road.up[1] * frame[4] + road.up[2] * frame[7]);
      to->roll = std::asin(Clamp(left, -1., 1.));
    }
    if (u) continue;
    s->yaw = std::atan2(frame[3], frame[0]);
    // Along the body's axes; the origin lies below the roll axis.
    s->vx = frame[0] * velocity[0] + frame[3] * velocity[1] + frame[6] * velocity[2];
    s->vy = frame[1] * velocity[0] + frame[4] * velocity[1] + frame[7] * velocity[2] -
            unit.roll_axis * to->roll_rate;
    const double shift = unit.roll_axis * to->roll;
    s->x = at[0] - shift * frame[1];
    s->y = at[1] - shift * frame[4];
  }
  s->initialized = 1;
}

void Plant::PlaceUnits(const PlantState& s, Scratch* at) const {
  for (size_t u = 0; u < units_.size(); ++u) {
    const PlantState::Unit& unit = s.unit[u];
    PlanarMotion<double>* to = &at->motion[u];
    to->yaw_rate = unit.yaw_rate;
    to->roll_rate = unit.roll_rate;
    if (u == 0) {
      to->vx = s.vx;
      to->vy = s.vy;
      at->cosine[0] = std::cos(s.yaw);
      at->sine[0] = std::sin(s.yaw);
      at->x[0] = s.x;
      at->y[0] = s.y;
      continue;
    }
    const PlanarInertia<double>& ahead = units_[u - 1].inertia;
    const double c = to->cosine = std::cos(unit.articulation);
    const double sn = to->sine = std::sin(unit.articulation);
    double hitch[2];
    HitchVelocity(ahead, at->motion[u - 1], hitch);
    // Where the road twists, the units lean apart, each about its tires' contacts: the coupling
    // then moves the unit's ground point sideways.
    const double lean = s.unit[u - 1].tilt_rate - unit.tilt_rate;
    hitch[1] -= units_[u].front_height * lean;
    to->vx = c * hitch[0] + sn * hitch[1];
    to->vy = c * hitch[1] - sn * hitch[0];
    at->cosine[u] = c * at->cosine[u - 1] - sn * at->sine[u - 1];
    at->sine[u] = c * at->sine[u - 1] + sn * at->cosine[u - 1];
    at->x[u] = at->x[u - 1] + ahead.hitch_x * at->cosine[u - 1];
    at->y[u] = at->y[u - 1] + ahead.hitch_x * at->sine[u - 1];
  }
}

// One step; without `commit` only the forces, accelerations and next states of the plugins.
template <bool kRolls>
void Plant::Compute(const mjModel* m, mjData* d, PlantState* s, bool commit) const {
  const double h = m->opt.timestep;
  const int units = static_cast<int>(units_.size());
  const double gravity = mju_norm3(m->opt.gravity);
  Scratch at;
  PlaceUnits(*s, &at);

  // Forward speeds of the hubs, for the brakes.
  double hub_speed[2 * kPlantAxlesMax];
  Pair steer[kPlantAxlesMax] = {};
  for (size_t a = 0; a < axles_.size(); ++a) {
    const Axle& axle = axles_[a];
    const PlanarMotion<double>& v = at.motion[axle.unit];
    const double vy = v.vy + axle.x * v.yaw_rate + units_[axle.unit].coupling * v.roll_rate;
    for (int side = 0; side < 2; ++side) {
      const double y = side ? -axle.half_track : axle.half_track;
      double speed = v.vx - y * v.yaw_rate;
      if (axle.steered) {
        const double angle = d->qpos[axle.knuckle_qpos[side]];
        steer[a][side] = angle;
        speed = std::cos(angle) * speed + std::sin(angle) * vy;
      }
      hub_speed[axle.hub[side]] = speed;
      d->qfrc_passive[axle.spin[side]] = 0;
    }
  }
  powertrain_plugin_->compute(m, d, powertrain_instance_, mjPLUGIN_ACTUATOR);
  steering_plugin_->compute(m, d, steering_instance_, mjPLUGIN_ACTUATOR);
  ActuateAirBrake(m, d, brake_instance_, hub_speed);
  brake_plugin_->compute(m, d, brake_instance_, mjPLUGIN_PASSIVE);
  const double shaft_torque = d->actuator_force[shaft_force_];
  const double pitman_angle = reinterpret_cast<const SteeringStates*>(
                                  d->plugin_state + m->plugin_stateadr[steering_instance_])
                                  ->now.pitman_angle;

  // Tires.
  double pitch[kUnitsMax];  // moment of each unit about its coupling
  int left_range = 0;
  double slope[kUnitsMax][2];  // of the road's plane below each unit, world axes, over the normal
  for (int u = 0; u < units; ++u) {
    const Unit& unit = units_[u];
    const PlanarMotion<double>& v = at.motion[u];
    PlanarVector<double> q = {0, 0, 0, 0};
    double loads = 0, sx = 0, sy = 0, tire_x = 0, resistance = 0;
    const double base = v.vy + unit.coupling * v.roll_rate;  // of the roll axis
    for (int a = unit.first_axle; a < unit.end_axle; ++a) {
      const Axle& axle = axles_[a];
      const double c = at.cosine[u], sn = at.sine[u], t = axle.half_track;
      TireState* const state[2] = {reinterpret_cast<TireState*>(d->plugin_state + axle.state[0]),
                                   reinterpret_cast<TireState*>(d->plugin_state + axle.state[1])};
      const double px = at.x[u] + c * axle.x, py = at.y[u] + sn * axle.x;
      RoadPoint<Pair> road =
          road_.Evaluate(m->numeric_data + road_address_, Pair{px - sn * t, px + sn * t},
                         Pair{py + c * t, py - c * t}, Pair{state[0]->station, state[1]->station});
      const Pair up[2] = {road.up[0] * road.norm, road.up[1] * road.norm};
      const double normal = 0.5 * (road.norm[0] + road.norm[1]);

      // Loads, of which no wheel can have less than nothing.
      const double load = Max(0., normal * axle.static_load + s->axle[a].pitch_load);
      const double moved = Clamp(s->axle[a].roll_moment / (2 * t), -0.5 * load, 0.5 * load);
      const Pair wheel_load = {0.5 * load - moved, 0.5 * load + moved};
      if (abs(moved) >= 0.5 * load) left_range |= kWheelLift;
      loads += load;
      sx += wheel_load[0] * up[0][0] + wheel_load[1] * up[0][1];
      sy += wheel_load[0] * up[1][0] + wheel_load[1] * up[1][1];

      // The tires' law, on a level road along the unit's axes.
      const Pair lost = {state[0]->puncture, state[1]->puncture};
      const TirePuncture<Pair> flat = axle.law->Puncture(lost);
      WheelMotion<Pair> wheel;
      wheel.height = (axle.law->free_radius - flat.drop) -
                     wheel_load / (flat.tires * axle.law->vertical_stiffness);
      for (int i = 0; i < 3; ++i) wheel.arm[i] = wheel.angular[i] = wheel.axle[i] = Fill<Pair>(0);
      if (axle.steered) {
        for (int side = 0; side < 2; ++side) {
          wheel.axle[0][side] = -std::sin(steer[a][side]);
          wheel.axle[1][side] = std::cos(steer[a][side]);
        }
      } else {
        wheel.axle[1] = Fill<Pair>(1);
      }
      wheel.velocity[0] = v.vx - Pair{t, -t} * v.yaw_rate;
      // The roll center moves sideways with the body, the tires' contacts with the axle's roll.
      wheel.velocity[1] = Fill<Pair>(base + axle.x * v.yaw_rate +
                                     (unit.roll_axis - axle.roll_center) * v.roll_rate +
                                     axle.roll_center * s->axle[a].roll_rate);
      wheel.velocity[2] = Fill<Pair>(0);
      wheel.angular[2] = Fill<Pair>(v.yaw_rate);
      wheel.spin = Pair{d->qvel[axle.spin[0]], d->qvel[axle.spin[1]]};
      wheel.carry = axle.carry;
      const RoadPoint<Pair> level = {Fill<Pair>(0),
                                     {Fill<Pair>(0), Fill<Pair>(0), Fill<Pair>(1)},
                                     Fill<Pair>(1),
                                     road.friction,
                                     road.station};
      const TireBristles<Pair> bristles = {{state[0]->bristles.x, state[1]->bristles.x},
                                           {state[0]->bristles.y, state[1]->bristles.y},
                                           {state[0]->bristles.spin, state[1]->bristles.spin}};
      const TireForces<Pair> f = axle.law->Step(wheel, level, bristles, h, lost);

      const Pair spin_moment = f.moment[0] * wheel.axle[0] + f.moment[1] * wheel.axle[1];
      double targets[2] = {0, 0};
      if (axle.target >= 0) steering_->Targets(axle.target, pitman_angle, targets);
      for (int side = 0; side < 2; ++side) {
        TireState* to = state[side];
        to->next_station = road.station[side];
        to->next_bristles = {f.next.x[side], f.next.y[side], f.next.spin[side]};
        for (int i = 0; i < f.kSignals; ++i) to->signal[i] = f.signal[i][side];
        const int dof = axle.spin[side];
        const double torque =
            spin_moment[side] + d->qfrc_passive[dof] + axle.shaft[side] * shaft_torque;
        d->qacc[dof] = torque * axle.inverse_inertia[side];
        if (axle.steered) {
          // As MuJoCo's integrator `implicitfast`: implicit in the damping.
          const double k = axle.knuckle_stiffness, angle = steer[a][side];
          const double rest = axle.target >= 0 ? targets[side] * steering_->stiffness : 0;
          const double moment = rest - k * angle + f.moment[2][side];
          double* rate = d->qvel + axle.knuckle[side];
          const double next = (axle.knuckle_inertia * *rate + h * moment) /
                              (axle.knuckle_inertia + h * axle.knuckle_damping);
          d->qacc[axle.knuckle[side]] = (next - *rate) / h;
        }
      }
      const double fx = f.force[0][0] + f.force[0][1], fy = f.force[1][0] + f.force[1][1];
      tire_x += fx;
      // With the static load's part along the road's plane. A load that is moved from axle to axle
      // has no part, because the plane's own axes count.
      const double weight = 0.5 * axle.static_load;
      const Pair wx = weight * (up[0] * c + up[1] * sn), wy = weight * (up[1] * c - up[0] * sn);
      const double along = fx + wx[0] + wx[1], left = fy + wy[0] + wy[1];
      q.x += along;
      q.y += left;
      q.yaw += axle.x * left - t * (f.force[0][0] + wx[0] - f.force[0][1] - wx[1]) +
               f.moment[2][0] + f.moment[2][1];
      at.lateral[a] = fy;
      // The law's moments are about the wheels' centers; this one is about the road.
      const Pair tilting = f.moment[0] * wheel.axle[1] - f.moment[1] * wheel.axle[0] -
                           wheel.height * (f.force[0] * wheel.axle[0] + f.force[1] * wheel.axle[1]);
      const Pair rolling =
          spin_moment + wheel.height * (f.force[0] * wheel.axle[1] - f.force[1] * wheel.axle[0]);
      // With the gyroscopic moment of the wheels.
      const Pair spin = wheel.spin / Pair{axle.inverse_inertia[0], axle.inverse_inertia[1]};
      at.overturning[a] = tilting[0] + tilting[1] + v.yaw_rate * (spin[0] + spin[1]);
      resistance += rolling[0] + rolling[1];
    }
    q.roll = unit.coupling * q.y;
    pitch[u] = resistance - unit.front_height * tire_x;

    at.tilt[u] = loads > 0 ? (sx * at.sine[u] - sy * at.cosine[u]) / loads : 0;

    // The road's slope below the unit: below its axles and its coupling, by their loads.
    slope[u][0] = sx;
    slope[u][1] = sy;
    double total = loads;
    if (u) {
      slope[u][0] += unit.coupling_load * slope[u - 1][0];
      slope[u][1] += unit.coupling_load * slope[u - 1][1];
      total += unit.coupling_load;
    }
    if (total > 0) {
      slope[u][0] /= total;
      slope[u][1] /= total;
    }
    // Of the weights, as a field along the unit's axes.
    const double gx = gravity * (slope[u][0] * at.cosine[u] + slope[u][1] * at.sine[u]);
    const double gy = -gravity * at.tilt[u];
    s->unit[u].gravity_x = gx;
    s->unit[u].gravity_y = gy;

    // Air.
    at.air_roll[u] = 0;
    const double wind_x = m->opt.wind[0] * at.cosine[u] + m->opt.wind[1] * at.sine[u];
    const double wind_y = m->opt.wind[1] * at.cosine[u] - m->opt.wind[0] * at.sine[u];
    for (const Unit::Air& air : unit.air) {
      const double lever = air.height - unit.roll_axis;
      const double ahead = v.vx - wind_x;
      const double left =
          v.vy + air.x * v.yaw_rate + (unit.coupling - lever) * v.roll_rate - wind_y;
      double force[2];
      air.law->Force(std::sqrt(ahead * ahead + left * left), ahead, left, force);
      q.x += force[0];
      q.y += force[1];
      q.yaw += air.x * force[1];
      q.roll += (unit.coupling - lever) * force[1];
      at.air_roll[u] -= lever * force[1];
      pitch[u] += (air.height - unit.front_height) * force[0];
    }

    // Roll of the sprung mass: weights, springs and the axles' roll centers.
    if constexpr (kRolls) {
      const PlantState::Unit& last = s->unit[u];
      // Bounded, so that a truck that has rolled over stays finite.
      q.roll += unit.tilting * (Clamp(last.roll, -1., 1.) + at.tilt[u]);
      for (int a = unit.first_axle; a < unit.end_axle; ++a) {
        const Axle& axle = axles_[a];
        PlantState::Axle* to = &s->axle[a];
        const double felt = last.acceleration.y + axle.x * last.acceleration.yaw +
                            unit.coupling * last.acceleration.roll - gy;
        const double transmitted = at.lateral[a] - axle.mass * felt;
        const double link =
            axle.roll_center * transmitted + axle.height * axle.mass * felt + at.overturning[a];
        // The axle hangs between tires, springs and dampers; it has no inertia in roll.
        const double spring = axle.roll_stiffness * last.roll + axle.roll_damping * last.roll_rate;
        const double whole = axle.roll_stiffness + axle.tire_roll_stiffness;
        to->roll_rate = (spring + link - whole * to->roll) / (axle.roll_damping + h * whole);
        const double most = axle.half_track * Max(0., axle.static_load + to->pitch_load);
        const double moment =
            Clamp(axle.tire_roll_stiffness * (to->roll + h * to->roll_rate), -most, most);
        q.roll -= moment - link + (axle.roll_center - unit.roll_axis) * transmitted;
        to->roll_moment = moment;
      }
      if (abs(last.roll) > kRollMax) left_range |= kRollAngle;
    }
    at.force[u] = q;
  }

  // Couplings: friction and stops in yaw, elastic in roll.
  for (int u = 1; u < units; ++u) {
    const Unit& unit = units_[u];
    const PlantState::Unit &own = s->unit[u], &ahead = s->unit[u - 1];
    FifthWheelState* state = reinterpret_cast<FifthWheelState*>(d->plugin_state + unit.law_state);
    const double rate = own.yaw_rate - ahead.yaw_rate;
    state->next_wind_up = state->wind_up;
    double yaw = unit.law->YawMoment(rate, h, &state->next_wind_up);
    if (unit.limited) {
      const double beyond = own.articulation - Clamp(own.articulation, unit.yaw_min, unit.yaw_max);
      if (beyond != 0) {
        left_range |= kArticulation;
        yaw -= kStopStiffness * beyond + kStopDamping * rate;
      }
    }
    at.force[u].yaw += yaw;
    at.force[u - 1].yaw -= yaw;
    if constexpr (kRolls) {
      const double c = at.motion[u].cosine;
      const double roll =
          unit.law->RollMoment(own.roll + at.tilt[u] - c * (ahead.roll + at.tilt[u - 1]),
                               own.roll_rate - c * ahead.roll_rate);
      at.coupling_roll[u] = roll;
      at.force[u].roll += roll;
      at.force[u - 1].roll -= c * roll;
    }
  }

  PlanarVector<double> acceleration[kUnitsMax];
  Accelerate<kRolls>(inertia_.data(), at.motion, at.force, units, acceleration, at.hitch);
  for (int u = 0; u < units; ++u) s->unit[u].acceleration = acceleration[u];
  s->left_range = static_cast<int>(s->left_range) | left_range;
  if (!commit) return;

  // Semi-implicit: velocities first, then positions with the new velocities.
  for (size_t a = 0; a < axles_.size(); ++a) {
    const Axle& axle = axles_[a];
    for (int side = 0; side < 2; ++side) {
      const int dof = axle.spin[side];
      d->qvel[dof] += h * d->qacc[dof];
      d->qpos[axle.spin_qpos[side]] += h * d->qvel[dof];
      TireState* state = reinterpret_cast<TireState*>(d->plugin_state + axle.state[side]);
      state->bristles = state->next_bristles;
      state->station = state->next_station;
      if (!axle.steered) continue;
      const int knuckle = axle.knuckle[side];
      d->qvel[knuckle] += h * d->qacc[knuckle];
      double* angle = d->qpos + axle.knuckle_qpos[side];
      *angle = Clamp(*angle + h * d->qvel[knuckle], -axle.knuckle_max, axle.knuckle_max);
    }
  }
  if constexpr (kRolls) {
    for (size_t a = 0; a < axles_.size(); ++a) s->axle[a].roll += h * s->axle[a].roll_rate;
  } else {
    RollStatically(h, &at, s);
  }
  MoveLoads(h, gravity, at, pitch, s);
  for (int u = 0; u < units; ++u) {
    PlantState::Unit* unit = &s->unit[u];
    unit->tilt_rate = s->initialized > 1 ? (at.tilt[u] - unit->tilt) / h : 0;
    unit->tilt = at.tilt[u];
  }
  s->initialized = 2;
  const double vx = s->vx + h * acceleration[0].x, vy = s->vy + h * acceleration[0].y;
  for (int u = 0; u < units; ++u) {
    PlantState::Unit* unit = &s->unit[u];
    unit->yaw_rate += h * acceleration[u].yaw;
    if constexpr (kRolls) {
      unit->roll_rate += h * acceleration[u].roll;
      unit->roll += h * unit->roll_rate;
    }
    if (u) unit->articulation += h * (unit->yaw_rate - s->unit[u - 1].yaw_rate);
  }
  // The velocity over ground turns against the unit's axes, by Cayley's exact rotation.
  const double turn = h * s->unit[0].yaw_rate, half = 0.5 * turn;
  const double scale = 1 / (1 + half * half);
  const double c = scale * (1 - half * half), sn = scale * 2 * half;
  // Horizontal parts of the velocity along the road's plane.
  const double across = slope[0][1] * at.cosine[0] - slope[0][0] * at.sine[0];
  const double along = slope[0][0] * at.cosine[0] + slope[0][1] * at.sine[0];
  const double level_x = (1 - 0.5 * along * along) * vx, level_y = (1 - 0.5 * across * across) * vy;
  s->x += h * (at.cosine[0] * level_x - at.sine[0] * level_y);
  s->y += h * (at.sine[0] * level_x + at.cosine[0] * level_y);
  s->vx = c * vx + sn * vy;
  s->vy = c * vy - sn * vx;
  s->yaw += turn;
  for (int u = 1; u < units; ++u) {
    FifthWheelState* state =
        reinterpret_cast<FifthWheelState*>(d->plugin_state + units_[u].law_state);
    state->wind_up = state->next_wind_up;
  }
  powertrain_plugin_->advance(m, d, powertrain_instance_);
  steering_plugin_->advance(m, d, steering_instance_);
  brake_plugin_->advance(m, d, brake_instance_);
  d->time += h;
}

// Loads moved between the axles by pitch, with a lag in place of the springs' motion.
void Plant::MoveLoads(double h, double gravity, const Scratch& at, const double* pitch,
                      PlantState* s) const {
  const int units = static_cast<int>(units_.size());
  double moment[kUnitsMax];
  for (int u = 0; u < units; ++u) {
    const Unit& unit = units_[u];
    const PlantState::Unit& now = s->unit[u];
    moment[u] = pitch[u] - unit.pitch_inertia * (now.acceleration.x - now.gravity_x) +
                unit.pitch_product * now.yaw_rate * now.yaw_rate;
    if (u + 1 < units) {
      // The unit behind pulls at its coupling.
      const double pull =
          at.motion[u + 1].cosine * at.hitch[u + 1][0] - at.motion[u + 1].sine * at.hitch[u + 1][1];
      const double weight = units_[u + 1].coupling_load * now.gravity_x / gravity;
      moment[u] -= (unit.hitch_height - unit.front_height) * (pull - weight);
      // Its roll moment is about its own axis.
      moment[u] -= at.motion[u + 1].sine * at.coupling_roll[u + 1];
    }
  }
  const double share = LagShare(h, kLoadLag);
  for (size_t a = 0; a < axles_.size(); ++a) {
    double load = 0;
    for (int u = 0; u < units; ++u) load += axles_[a].pitch_gain[u] * moment[u];
    s->axle[a].pitch_load += share * (load - s->axle[a].pitch_load);
  }
}

// Roll at equilibrium, for the lateral load transfer: springs, weights and couplings, solved from
// the last unit to the first.
void Plant::RollStatically(double h, Scratch* scratch, PlantState* s) const {
  const Scratch& at = *scratch;
  const int units = static_cast<int>(units_.size());
  double link[kPlantAxlesMax], stiffness[kUnitsMax], moment[kUnitsMax], pass[kUnitsMax];
  for (int u = units - 1; u >= 0; --u) {
    const Unit& unit = units_[u];
    const PlantState::Unit& now = s->unit[u];
    const double felt = now.acceleration.y - now.gravity_y;
    moment[u] = unit.sprung_lever * unit.sprung_mass *
                    (now.acceleration.y + unit.sprung_x * now.acceleration.yaw) +
                unit.tilting * at.tilt[u] + at.air_roll[u] - unit.coupling * at.hitch[u][1];
    stiffness[u] = -unit.tilting;
    for (int a = unit.first_axle; a < unit.end_axle; ++a) {
      const Axle& axle = axles_[a];
      const double local = felt + axle.x * now.acceleration.yaw;
      const double transmitted = at.lateral[a] - axle.mass * local;
      link[a] =
          axle.roll_center * transmitted + axle.height * axle.mass * local + at.overturning[a];
      moment[u] += (1 - axle.share) * link[a] - (axle.roll_center - unit.roll_axis) * transmitted;
      stiffness[u] += axle.share * axle.roll_stiffness;
    }
    pass[u] = 0;
    if (u + 1 < units) {
      const double c = at.motion[u + 1].cosine, sn = at.motion[u + 1].sine;
      const double side = sn * at.hitch[u + 1][0] + c * at.hitch[u + 1][1];
      moment[u] += (unit.hitch_height - unit.roll_axis) * side;
      // The unit behind leans on this one through the coupling's stiffness.
      const double k = units_[u + 1].law->roll_stiffness;
      const double whole = stiffness[u + 1] + k;
      pass[u] = c * k / whole;
      stiffness[u] += c * c * k * (1 - k / whole);
      moment[u] += pass[u] * moment[u + 1];
    }
  }
  const double share = LagShare(h, kLoadLag);
  double roll = 0;
  for (int u = 0; u < units; ++u) {
    const double k = u ? units_[u].law->roll_stiffness : 0;
    const double c = u ? at.motion[u].cosine : 1;
    const double ahead = u ? c * (roll + at.tilt[u - 1]) - at.tilt[u] : 0;
    roll = (moment[u] + k * ahead) / (stiffness[u] + k);
    scratch->coupling_roll[u] = k * (ahead - roll);
    for (int a = units_[u].first_axle; a < units_[u].end_axle; ++a) {
      const Axle& axle = axles_[a];
      const double target = axle.share * (axle.roll_stiffness * roll + link[a]);
      s->axle[a].roll_moment += share * (target - s->axle[a].roll_moment);
    }
  }
}

// Writes pose, velocities and accelerations, and computes the sensors.
void Plant::Publish(const mjModel* m, mjData* d, PlantState* s) const {
  Scratch at;
  PlaceUnits(*s, &at);
  const double* rows = m->numeric_data + road_address_;
  double before[9], hitch_z = 0;
  for (size_t u = 0; u < units_.size(); ++u) {
    const Unit& unit = units_[u];
    const PlantState::Unit& now = s->unit[u];
    // Height and tilt of the road below the axles; the first axle and the others of the lead unit,
    // the coupling and all axles of a towed unit.
    double front_x = 0, front_z = 0, rear_x = 0, rear_z = 0, tilt = 0;
    int rear = 0;
    for (int a = unit.first_axle; a < unit.end_axle; ++a) {
      const Axle& axle = axles_[a];
      const double t = axle.half_track, c = at.cosine[u], sn = at.sine[u];
      const double px = at.x[u] + c * axle.x, py = at.y[u] + sn * axle.x;
      const mjtNum* state = d->plugin_state;
      const RoadPoint<Pair> road =
          road_.Evaluate(rows, Pair{px - sn * t, px + sn * t}, Pair{py + c * t, py - c * t},
                         Pair{reinterpret_cast<const TireState*>(state + axle.state[0])->station,
                              reinterpret_cast<const TireState*>(state + axle.state[1])->station});
      const double z = 0.5 * (road.height[0] + road.height[1]);
      tilt += (road.height[0] - road.height[1]) / (2 * t);
      if (u == 0 && a == unit.first_axle) {
        front_x = axle.x;
        front_z = z;
      } else {
        ++rear;
        rear_x += axle.x;
        rear_z += z;
      }
    }
    tilt /= unit.end_axle - unit.first_axle;
    if (u) front_z = hitch_z - unit.front_height;
    double grade = 0;
    if (rear) grade = (front_z - rear_z / rear) / (front_x - rear_x / rear);
    const double forward = 1 / std::sqrt(1 + grade * grade);
    double frame[9], x[3] = {forward * at.cosine[u], forward * at.sine[u], forward * grade};
    double y[3] = {-at.sine[u], at.cosine[u], tilt}, z[3];
    mju_cross(z, x, y);
    mju_normalize3(z);
    mju_cross(y, z, x);
    const double cr = std::cos(now.roll), sr = std::sin(now.roll);
    double left[3], up[3];
    for (int i = 0; i < 3; ++i) {
      left[i] = cr * y[i] + sr * z[i];
      up[i] = cr * z[i] - sr * y[i];
      frame[3 * i] = x[i];
      frame[3 * i + 1] = left[i];
      frame[3 * i + 2] = up[i];
    }
    const PlanarMotion<double>& v = at.motion[u];
    if (u == 0) {
      const double shift = unit.roll_axis * now.roll, sway = unit.roll_axis * now.roll_rate;
      double* position = d->qpos + lead_qpos_;
      const double height = front_z - grade * front_x;
      const double origin[3] = {s->x, s->y, height};
      const double sway_change = unit.roll_axis * now.acceleration.roll;
      for (int i = 0; i < 3; ++i) {
        position[i] = origin[i] + shift * y[i];
        d->qvel[lead_dof_ + i] = v.vx * x[i] + (v.vy + sway) * y[i];
        d->qacc[lead_dof_ + i] =
            now.acceleration.x * x[i] + (now.acceleration.y + sway_change) * y[i];
      }
      mju_mat2Quat(position + 3, frame);
      const double turning[3] = {now.roll_rate, sr * now.yaw_rate, cr * now.yaw_rate};
      const double change[3] = {now.acceleration.roll, sr * now.acceleration.yaw,
                                cr * now.acceleration.yaw};
      std::memcpy(d->qvel + lead_dof_ + 3, turning, sizeof(turning));
      std::memcpy(d->qacc + lead_dof_ + 3, change, sizeof(change));
      hitch_z = height;
    } else {
      double relative[9];
      mju_mulMatTMat(relative, before, frame, 3, 3, 3);
      const PlantState::Unit& ahead = s->unit[u - 1];
      double* angles = d->qpos + unit.yaw_qpos;
      angles[0] = std::atan2(relative[3], relative[0]);
      angles[1] = -std::asin(Clamp(relative[6], -1., 1.));
      angles[2] = std::atan2(relative[7], relative[8]);
      d->qvel[unit.yaw_dof] = now.yaw_rate - ahead.yaw_rate;
      d->qvel[unit.yaw_dof + 1] = 0;
      d->qvel[unit.yaw_dof + 2] = now.roll_rate - v.cosine * ahead.roll_rate;
      d->qacc[unit.yaw_dof] = now.acceleration.yaw - ahead.acceleration.yaw;
      d->qacc[unit.yaw_dof + 1] = 0;
      d->qacc[unit.yaw_dof + 2] = now.acceleration.roll - v.cosine * ahead.acceleration.roll;
      hitch_z = front_z;
    }
    // Of the next unit's coupling.
    hitch_z += grade * unit.inertia.hitch_x * forward + unit.hitch_height;
    std::memcpy(before, frame, sizeof(before));
    for (int a = unit.first_axle; a < unit.end_axle; ++a) {
      // The wheels stay on the road.
      if (rolls_) d->qpos[axles_[a].roll_qpos] = s->axle[a].roll - now.roll;
    }
  }
  Remember(m, d, s->seen);
  mj_kinematics(m, d);
  mj_comPos(m, d);
  mj_collision(m, d);
  if (m->opt.disableflags & mjDSBL_SENSOR) return;
  mj_comVel(m, d);
  d->flg_rnepost = d->flg_subtreevel = 0;
  mj_sensorPos(m, d);
  mj_sensorVel(m, d);
  mj_sensorAcc(m, d);
}

bool Plant::Step(const mjModel* m, mjData* d, int count, bool observe) const {
  PlantState* s = State(m, d);
  double seen[13 + 6 * kUnitsMax] = {};
  Remember(m, d, seen);
  if (s->initialized == 0 || std::memcmp(seen, s->seen, sizeof(seen)) != 0) Adopt(m, d, s);
  for (int i = 0; i < count; ++i) {
    rolls_ ? Compute<true>(m, d, s, true) : Compute<false>(m, d, s, true);
  }
  if (observe) {
    // On a copy, so that an observation does not change later bits.
    PlantState seen_now = *s;
    rolls_ ? Compute<true>(m, d, &seen_now, false) : Compute<false>(m, d, &seen_now, false);
    Publish(m, d, &seen_now);
    std::memcpy(s->seen, seen_now.seen, sizeof(s->seen));
  } else {
    Publish(m, d, s);
  }
  const PlantState::Unit& last = s->unit[units_.size() - 1];
  return std::isfinite(s->x + s->y + s->vx + s->vy + s->yaw + last.articulation + last.roll);
}

}  // namespace iits

// Called by iits_mj/truck/plant.py.
#define IITS_EXPORT extern "C" __attribute__((visibility("default")))

IITS_EXPORT void* iits_plant_create(const mjModel* m, const char* prefix, int rolls, char* error,
                                    int size);
void* iits_plant_create(const mjModel* m, const char* prefix, int rolls, char* error, int size) {
  std::string message;
  if (m->nuserdata < static_cast<int>(sizeof(iits::PlantState) / sizeof(mjtNum))) {
    message = "the model has too little userdata";
  }
  auto plant =
      message.empty() ? std::make_unique<iits::Plant>(m, prefix, rolls != 0, &message) : nullptr;
  std::strncpy(error, message.c_str(), size - 1);
  error[size - 1] = 0;
  return message.empty() ? plant.release() : nullptr;
}

IITS_EXPORT void iits_plant_delete(void* plant);
void iits_plant_delete(void* plant) { delete static_cast<iits::Plant*>(plant); }

IITS_EXPORT int iits_plant_state_size(void);
int iits_plant_state_size(void) { return sizeof(iits::PlantState) / sizeof(mjtNum); }

// Plant::Step of each of the `size` data.
IITS_EXPORT void iits_plant_step(const void* plant, const mjModel* m, mjData* const* data, int size,
                                 int count, int observe, int* alive);
void iits_plant_step(const void* plant, const mjModel* m, mjData* const* data, int size, int count,
                     int observe, int* alive) {
  for (int i = 0; i < size; ++i) {
    alive[i] = static_cast<const iits::Plant*>(plant)->Step(m, data[i], count, observe != 0);
  }
}
