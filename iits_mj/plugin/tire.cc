#include "plugin/tire.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "plugin/config.h"
#include "plugin/registration.h"

namespace iits {
namespace {

constexpr double kReferenceFriction = 0.8;  // surface on which the friction attributes hold
constexpr double kSlideSlip = 1.0;          // theoretical slip beyond which the tread just slides
constexpr double kLowSpeed = 2.0;           // [m/s] where the standstill damping has faded out
constexpr double kLowSpeedDamping = 6000;   // [N s/m] per tire
constexpr double kSpinWindUp = 0.01;        // [rad] of wheel rotation to full rolling resistance
constexpr double kSpinDamping = 0.08;       // [s] damping of that wind-up, over its stiffness
constexpr double kTurnBegin = 3, kTurnEnd = 9;  // normalised slip over which sliding sets in

const char* const kAttributes[] = {"count",
                                   "free_radius",
                                   "rolling_radius",
                                   "vertical_stiffness",
                                   "vertical_damping",
                                   "cornering_coefficient",
                                   "pneumatic_trail",
                                   "nominal_load",
                                   "friction_lateral",
                                   "friction_longitudinal",
                                   "friction_load_slope",
                                   "shape_lateral",
                                   "shape_longitudinal",
                                   "curvature_lateral",
                                   "curvature_longitudinal",
                                   "load_saturation",
                                   "slip_stiffness",
                                   "relaxation_lateral",
                                   "relaxation_load_exponent",
                                   "relaxation_longitudinal",
                                   "rolling_resistance"};

bool EndsWith(const std::string& text, const std::string& tail) {
  return text.size() >= tail.size() &&
         text.compare(text.size() - tail.size(), tail.size(), tail) == 0;
}

double Dot(const mjtNum a[3], const mjtNum b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void Cross(const mjtNum a[3], const mjtNum b[3], mjtNum out[3]) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

// Magic Formula over normalised slip rho = K s / (mu Fz), unit initial slope and unit peak.
double MagicFormula(double rho, double shape, double curvature) {
  double b = rho / shape;
  return std::sin(shape * std::atan(b - curvature * (b - std::atan(b))));
}

}  // namespace

Tire* Tire::Create(const mjModel* m, int instance) {
  std::unique_ptr<Tire> t(new Tire());
  const struct {
    const char* name;
    double low, high;
    double* value;
  } attributes[] = {
      {"count", 1, 2, &t->count_},
      {"free_radius", 0.05, 5, &t->free_radius_},
      {"rolling_radius", 0.05, 5, &t->rolling_radius_},
      {"vertical_stiffness", 1e3, 1e8, &t->vertical_stiffness_},
      {"vertical_damping", 0, 1e6, &t->vertical_damping_},
      {"cornering_coefficient", 0.1, 50, &t->cornering_coefficient_},
      {"pneumatic_trail", 0, 0.5, &t->pneumatic_trail_},
      {"nominal_load", 100, 1e6, &t->nominal_load_},
      {"friction_lateral", 0.01, 3, &t->friction_lateral_},
      {"friction_longitudinal", 0.01, 3, &t->friction_longitudinal_},
      {"friction_load_slope", 0, 0.5, &t->friction_load_slope_},
      {"shape_lateral", 1, 2, &t->shape_lateral_},
      {"shape_longitudinal", 1, 2, &t->shape_longitudinal_},
      {"curvature_lateral", -10, 1, &t->curvature_lateral_},
      {"curvature_longitudinal", -10, 1, &t->curvature_longitudinal_},
      {"load_saturation", 0.5, 20, &t->load_saturation_},
      {"slip_stiffness", 1, 100, &t->slip_stiffness_},
      {"relaxation_lateral", 0.05, 5, &t->relaxation_lateral_},
      {"relaxation_load_exponent", 0, 2, &t->relaxation_load_exponent_},
      {"relaxation_longitudinal", 0.05, 5, &t->relaxation_longitudinal_},
      {"rolling_resistance", 0, 0.2, &t->rolling_resistance_},
  };
  for (const auto& a : attributes) {
    *a.value = std::nan("");
    if (!ReadNumber(m, instance, a.name, a.low, a.high, a.value)) return nullptr;
  }
  t->nominal_deflection_ = t->nominal_load_ / t->vertical_stiffness_;
  double x = 1 / t->load_saturation_;
  t->cornering_scale_ =
      t->cornering_coefficient_ * t->nominal_load_ / (2 * x / (1 + x * x));  // so K(Fz0) = c Fz0

  for (int body : BodiesOfInstance(m, instance)) {
    int joint = m->body_jntadr[body];
    if (m->body_jntnum[body] != 1 || m->jnt_type[joint] != mjJNT_HINGE) {
      mju_warning("plugin instance '%s': wheel body '%s' must have exactly one hinge joint",
                  InstanceName(m, instance).c_str(), m->names + m->name_bodyadr[body]);
      return nullptr;
    }
    t->wheels_.push_back({body, m->body_parentid[body], m->jnt_dofadr[joint]});
  }
  for (int i = 0; i < m->nsensor; ++i) {
    if (m->sensor_plugin[i] != instance) continue;
    std::string name = m->names + m->name_sensoradr[i];
    Sensor sensor = {m->sensor_adr[i], -1, EndsWith(name, "_tire_slip") ? 4 : 0, m->sensor_dim[i]};
    for (size_t w = 0; w < t->wheels_.size(); ++w) {
      if (m->sensor_objtype[i] == mjOBJ_BODY && m->sensor_objid[i] == t->wheels_[w].body) {
        sensor.wheel = static_cast<int>(w);
      }
    }
    if (sensor.wheel < 0) {
      mju_warning("plugin instance '%s': sensor '%s' needs objtype='body' and one of its wheels",
                  InstanceName(m, instance).c_str(), name.c_str());
      return nullptr;
    }
    t->sensors_.push_back(sensor);
  }
  if (!t->road_.Bind(m, instance)) return nullptr;
  return t.release();
}

int Tire::StateSize(const mjModel* m, int instance) {
  return kStateSize * static_cast<int>(BodiesOfInstance(m, instance).size());
}

void Tire::Reset(mjtNum* plugin_state) const {
  State* states = reinterpret_cast<State*>(plugin_state);
  for (size_t i = 0; i < wheels_.size(); ++i) {
    states[i] = State();
    states[i].station = states[i].next_station = Road::kUnknownStation;
  }
}

// Forces of the whole wheel end at given theoretical slips. Similarity method: both slips are
// normalised by their own stiffness and friction, the force follows the resultant (Pacejka, "Tire
// and Vehicle Dynamics", 3rd ed., section 4.3.1).
Tire::Slip Tire::Combine(double sx, double sy, double load, double surface) const {
  double per_tire = load / count_;
  double relative = per_tire / nominal_load_;
  double fade = std::max(0.3, 1 - friction_load_slope_ * (relative - 1));
  double limit_x = friction_longitudinal_ * fade * surface * load;
  double limit_y = friction_lateral_ * fade * surface * load;
  double x = relative / load_saturation_;
  // K_y = c1 sin(2 atan(Fz / (c2 Fz0))) per tire, and sin(2 atan x) = 2x / (1 + x^2).
  double stiffness_y = count_ * cornering_scale_ * 2 * x / (1 + x * x);
  double stiffness_x = slip_stiffness_ * load;
  double qx = stiffness_x * sx / limit_x;
  double qy = stiffness_y * sy / limit_y;
  double rho = std::sqrt(qx * qx + qy * qy);
  Slip slip = {sx, sy, 0, 0, rho};
  if (rho < 1e-9) {
    slip.fx = stiffness_x * sx;
    slip.fy = stiffness_y * sy;
    return slip;
  }
  double along = qx / rho, across = qy / rho;
  if (rho > kTurnBegin) {
    // The tread sticks with its stiffnesses, but slides straight against the sliding velocity.
    double sliding = std::min(1.0, (rho - kTurnBegin) / (kTurnEnd - kTurnBegin));
    double total = std::sqrt(sx * sx + sy * sy);
    along += sliding * (sx / total - along);
    across += sliding * (sy / total - across);
  }
  slip.fx = limit_x * MagicFormula(rho, shape_longitudinal_, curvature_longitudinal_) * along;
  slip.fy = limit_y * MagicFormula(rho, shape_lateral_, curvature_lateral_) * across;
  return slip;
}

void Tire::WheelForces(const mjModel* m, mjData* d, const Wheel& wheel, State* s) const {
  const double h = m->opt.timestep;
  const mjtNum* center = d->xpos + 3 * wheel.body;
  const mjtNum* mat = d->xmat + 9 * wheel.hub;
  RoadPoint road = road_.Evaluate(m, center[0], center[1], s->station);
  s->next_station = road.station;

  mjtNum linear[3], angular[3];
  PointVelocity(m, d, wheel.hub, center, linear, angular);
  double distance = (center[2] - road.height) * road.normal[2];
  double deflection = free_radius_ - distance;
  double load = 0;
  if (deflection > 0) {
    load =
        count_ * (vertical_stiffness_ * deflection - vertical_damping_ * Dot(linear, road.normal));
  }
  if (!(load > 1)) {
    // In the air: the tread forgets.
    s->next_bristle_x = s->next_bristle_y = s->next_bristle_spin = 0;
    for (double& value : s->signal) value = 0;
    return;
  }

  // Contact frame: ex along the wheel's heading in the road plane, ey to the left, normal up.
  const mjtNum axle[3] = {mat[1], mat[4], mat[7]};
  mjtNum ex[3], ey[3];
  Cross(axle, road.normal, ex);
  double scale = 1 / std::sqrt(std::max(1e-12, Dot(ex, ex)));
  for (double& value : ex) value *= scale;
  Cross(road.normal, ex, ey);

  double spin = d->qvel[wheel.dof];
  double rolling_radius = rolling_radius_ + (nominal_deflection_ - deflection) / 3;
  mjtNum patch_arm[3] = {-distance * road.normal[0], -distance * road.normal[1],
                         -distance * road.normal[2]};
  mjtNum roll_velocity[3];
  Cross(angular, patch_arm, roll_velocity);
  double slip_vx = Dot(linear, ex) - rolling_radius * spin;
  double slip_vy = Dot(linear, ey) + Dot(roll_velocity, ey);
  double transport = std::abs(rolling_radius * spin);

  // Relaxation: dz/dt = -Vs - |Vr| z / sigma, semi-implicit, so that it holds at standstill.
  double relative = load / (count_ * nominal_load_);
  double sigma_y =
      std::max(0.1, relaxation_lateral_ * std::pow(relative, relaxation_load_exponent_));
  double sigma_x = relaxation_longitudinal_;
  double zx = (s->bristle_x - h * slip_vx) / (1 + h * transport / sigma_x);
  double zy = (s->bristle_y - h * slip_vy) / (1 + h * transport / sigma_y);
  double surface = road.friction / kReferenceFriction;
  double magnitude = std::sqrt(zx * zx / (sigma_x * sigma_x) + zy * zy / (sigma_y * sigma_y));
  if (magnitude > kSlideSlip) {
    // Beyond it the strain points against the sliding velocity: a locked wheel has no other sense
    // of direction, whatever its relaxation lengths.
    double speed = std::sqrt(slip_vx * slip_vx + slip_vy * slip_vy);
    zx = speed > 1e-6 ? -kSlideSlip * sigma_x * slip_vx / speed : zx * kSlideSlip / magnitude;
    zy = speed > 1e-6 ? -kSlideSlip * sigma_y * slip_vy / speed : zy * kSlideSlip / magnitude;
  }
  Slip slip = Combine(zx / sigma_x, zy / sigma_y, load, surface);
  double fx = slip.fx, fy = slip.fy;
  double damping = count_ * kLowSpeedDamping * std::max(0.0, 1 - transport / kLowSpeed) *
                   std::max(0.0, 1 - slip.saturation / 3) * std::min(1.0, relative);
  fx -= damping * slip_vx;
  fy -= damping * slip_vy;
  s->next_bristle_x = zx;
  s->next_bristle_y = zy;

  // Aligning moment: pneumatic trail of the brush model, gone at full sliding.
  double slide = std::min(1.0, slip.saturation / 3);
  double trail =
      pneumatic_trail_ * (1 - slide) * (1 - slide) * (1 - slide) / (1 - slide + slide * slide / 3);
  double mz = -trail * slip.fy;

  // Rolling resistance as an elasto-plastic wind-up of the wheel, so that it can hold, too.
  double resistance = rolling_resistance_ * load * rolling_radius;
  double wind_up = std::clamp(s->bristle_spin + h * spin, -kSpinWindUp, kSpinWindUp);
  s->next_bristle_spin = wind_up;
  double my = -resistance * std::clamp((wind_up + kSpinDamping * spin) / kSpinWindUp, -1.0, 1.0);

  // Forces act at the patch; the spin moment uses the rolling radius, which conserves energy.
  double mx = distance * fy;
  mjtNum force[3], torque[3];
  for (int i = 0; i < 3; ++i) {
    force[i] = fx * ex[i] + fy * ey[i] + load * road.normal[i];
    torque[i] = mx * ex[i] + (my - rolling_radius * fx) * ey[i] + mz * road.normal[i];
  }
  ApplyWrench(m, d, wheel.body, center, force, torque, d->qfrc_passive);

  s->signal[0] = fx;
  s->signal[1] = fy;
  s->signal[2] = load;
  s->signal[3] = mz;
  double forward = std::abs(Dot(linear, ex));
  s->signal[4] = -slip_vx / std::max(forward, 0.5);
  s->signal[5] = std::atan2(-slip_vy, std::max(forward, 0.5));
  s->signal[6] = deflection;
  s->signal[7] = road.friction;
}

void Tire::Passive(const mjModel* m, mjData* d, int instance) const {
  State* states = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  for (size_t i = 0; i < wheels_.size(); ++i) WheelForces(m, d, wheels_[i], states + i);
}

void Tire::Sensors(const mjModel* m, mjData* d, int instance) const {
  const State* states =
      reinterpret_cast<const State*>(d->plugin_state + m->plugin_stateadr[instance]);
  for (const Sensor& sensor : sensors_) {
    for (int i = 0; i < sensor.count; ++i) {
      d->sensordata[sensor.address + i] = states[sensor.wheel].signal[sensor.first + i];
    }
  }
}

void Tire::Advance(const mjModel* m, mjData* d, int instance) const {
  State* states = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  for (size_t i = 0; i < wheels_.size(); ++i) {
    State& s = states[i];
    s.bristle_x = s.next_bristle_x;
    s.bristle_y = s.next_bristle_y;
    s.bristle_spin = s.next_bristle_spin;
    s.station = s.next_station;
  }
}

void RegisterTire() {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "iits.tire";
  plugin.capabilityflags = mjPLUGIN_PASSIVE | mjPLUGIN_SENSOR;
  plugin.nattribute = sizeof(kAttributes) / sizeof(kAttributes[0]);
  plugin.attributes = kAttributes;
  plugin.needstage = mjSTAGE_VEL;
  plugin.nstate = Tire::StateSize;
  // Forces are (Fx, Fy, Fz), slips are (longitudinal slip, slip angle).
  plugin.nsensordata = +[](const mjModel* m, int, int sensor) {
    return EndsWith(m->names + m->name_sensoradr[sensor], "_tire_slip") ? 2 : 3;
  };
  plugin.init = +[](const mjModel* m, mjData* d, int instance) {
    Tire* tire = Tire::Create(m, instance);
    d->plugin_data[instance] = reinterpret_cast<uintptr_t>(tire);
    return tire ? 0 : -1;
  };
  plugin.destroy = +[](mjData* d, int instance) {
    delete reinterpret_cast<Tire*>(d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
  };
  plugin.reset = +[](const mjModel*, mjtNum* plugin_state, void* plugin_data, int) {
    reinterpret_cast<Tire*>(plugin_data)->Reset(plugin_state);
  };
  plugin.compute = +[](const mjModel* m, mjData* d, int instance, int capability_bit) {
    const Tire* tire = reinterpret_cast<Tire*>(d->plugin_data[instance]);
    if (capability_bit & mjPLUGIN_PASSIVE) tire->Passive(m, d, instance);
    if (capability_bit & mjPLUGIN_SENSOR) tire->Sensors(m, d, instance);
  };
  plugin.advance = +[](const mjModel* m, mjData* d, int instance) {
    reinterpret_cast<Tire*>(d->plugin_data[instance])->Advance(m, d, instance);
  };
  mjp_registerPlugin(&plugin);
}

}  // namespace iits
