// Reads the planar plant's truck from the compiled model: units, axles and the plugins' laws.
#include "plugin/plant/vehicle.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "plugin/plugin.h"

namespace iits {
namespace {

bool IsPlugin(const mjModel* m, int instance, const char* name) {
  int slot = -1;
  return instance >= 0 && mjp_getPlugin(name, &slot) && m->plugin[instance] == slot;
}

}  // namespace

Plant::Plant(const mjModel* m, const std::string& prefix, Motion motion, std::string* error)
    : rolls_(motion == Motion::kYawRoll),
      kinematic_(motion == Motion::kKinematic),
      own_(mj_makeData(m)) {
  mj_kinematics(m, own_);
  mj_comPos(m, own_);
  if (!FindUnits(m, prefix, error) || !FindAxles(m, error) || !FindPlugins(m, prefix, error)) {
    return;
  }
  SolvePitchGains(m);
  SumInertia(m);
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
    if (axle.target == 0) guide_ = static_cast<int>(&axle - axles_.data());
  }
  if (guide_ < 0) {
    *error = "the steering turns no axle of the truck";
    return false;
  }
  for (size_t u = 0; u < units_.size(); ++u) {
    Unit& unit = units_[u];
    double load = 0, moment = 0;
    for (int a = unit.first_axle; a < unit.end_axle; ++a) {
      load += axles_[a].static_load;
      moment += axles_[a].static_load * axles_[a].x;
    }
    unit.pole = u ? moment / load : axles_[guide_].x - steering_->wheelbase[0];
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

}  // namespace iits
