// A step of the planar plant.
#include <cmath>
#include <cstring>

#include "plugin/plant/vehicle.h"

namespace iits {
namespace {

constexpr double kCrestMax = 1;  // [m/s2] of the road's height below a unit, a tenth of the weight
constexpr double kSideMax = 2;   // [m/s2] sideways, where the slip of laden tires nears 2 degrees

// Rotation by about `turn` [rad], exactly orthogonal (Cayley).
struct Rotation {
  explicit Rotation(double turn) {
    const double half = 0.5 * turn, scale = 1 / (1 + half * half);
    cosine = scale * (1 - half * half);
    sine = scale * 2 * half;
  }
  double cosine, sine;
};

}  // namespace

PlantState* Plant::State(const mjModel* m, mjData* d) const {
  // The last part of the user's data, so that a user's own come first.
  return reinterpret_cast<PlantState*>(d->userdata + m->nuserdata) - 1;
}

// One step; without `commit` only the forces, accelerations and next states of the plugins.
template <bool kRolls>
void Plant::Compute(const mjModel* m, mjData* d, PlantState* s, bool commit) const {
  const double h = m->opt.timestep;
  const int units = static_cast<int>(units_.size());
  Scratch at;
  PlaceUnits(*s, &at);
  Actuate(m, d, &at);
  for (int u = 0; u < units; ++u) {
    AddTires(m, d, u, s, &at);
    MeasureSlope(m, u, s, &at);
    AddAir(m, u, &at);
    if constexpr (kRolls) AddRoll(h, u, s, &at);
  }
  AddCouplings(h, d, *s, &at);
  PlanarVector<double> acceleration[kUnitsMax];
  Accelerate<kRolls>(inertia_.data(), at.motion, at.force, units, acceleration, at.hitch);
  for (int u = 0; u < units; ++u) s->unit[u].acceleration = acceleration[u];
  // The couplings' forces stay those of axles that slip; they only move load between the tires.
  if (kinematic_) FollowAxles(h, s, &at);
  s->left_range = static_cast<int>(s->left_range) | at.left_range;
  if (commit) Advance<kRolls>(m, d, s, &at);
}

// Replaces the accelerations by those of axles that do not slip sideways: all velocities are then
// those of `direction` times the speed. The forces along it change the kinetic energy; a change of
// the direction alone does not.
void Plant::FollowAxles(double h, PlantState* s, Scratch* at) const {
  const double reach = steering_->wheelbase[0], half = 0.5 * steering_->track[0];
  double curvature = 0;
  for (int side = 0; side < 2; ++side) {
    const double tangent = std::tan(at->steer[guide_][side]);
    curvature += 0.5 * tangent / (reach + (side ? -half : half) * tangent);
  }
  PlanarVector<double> direction[kUnitsMax];
  direction[0] = {1, -units_[0].pole * curvature, curvature, 0};
  double force = 0, mass = 0, energy = 0;  // energy: twice the kinetic one [J]
  const int units = static_cast<int>(units_.size());
  for (int u = 0; u < units; ++u) {
    const PlanarInertia<double>& unit = inertia_[u];
    PlanarVector<double>& w = direction[u];
    if (u) {
      const PlanarVector<double>& ahead = direction[u - 1];
      const double y = ahead.y + inertia_[u - 1].hitch_x * ahead.yaw;
      w.x = at->motion[u].cosine * ahead.x + at->motion[u].sine * y;
      w.y = at->motion[u].cosine * y - at->motion[u].sine * ahead.x;
      w.yaw = -w.y / units_[u].pole;
      w.roll = 0;
    }
    const PlanarVector<double>& q = at->force[u];
    const PlanarMotion<double>& v = at->motion[u];
    force += q.x * w.x + q.y * w.y + q.yaw * w.yaw;
    mass += unit.mass * (w.x * w.x + w.y * w.y) + (2 * unit.x * w.y + unit.xx * w.yaw) * w.yaw;
    energy += unit.mass * (v.vx * v.vx + v.vy * v.vy) +
              (2 * unit.x * v.vy + unit.xx * v.yaw_rate) * v.yaw_rate;
  }
  const double speed = std::copysign(std::sqrt(energy / mass), s->vx) + h * force / mass;
  for (int u = 0; u < units; ++u) {
    PlanarVector<double>* to = &s->unit[u].acceleration;
    to->yaw = (speed * direction[u].yaw - s->unit[u].yaw_rate) / h;
    if (abs(speed * speed * direction[u].x * direction[u].yaw) > kSideMax) at->left_range |= kSlip;
    if (u) {
      // Of the hitch of the unit ahead, along this unit's axes.
      const PlanarVector<double>& ahead = s->unit[u - 1].acceleration;
      const double rate = s->unit[u - 1].yaw_rate, reach_back = inertia_[u - 1].hitch_x;
      const double x = ahead.x - reach_back * rate * rate, y = ahead.y + reach_back * ahead.yaw;
      to->x = at->motion[u].cosine * x + at->motion[u].sine * y;
      to->y = at->motion[u].cosine * y - at->motion[u].sine * x;
    } else {
      // What the rotation of the axes in `Advance` turns to the velocities wanted.
      const double x = speed, y = speed * direction[0].y;
      const auto [c, sn] = Rotation(h * speed * curvature);
      to->x = (c * x - sn * y - s->vx) / h;
      to->y = (sn * x + c * y - s->vy) / h;
    }
  }
}

// Integrates, semi-implicitly: velocities first, then positions with the new velocities.
template <bool kRolls>
void Plant::Advance(const mjModel* m, mjData* d, PlantState* s, Scratch* scratch) const {
  const Scratch& at = *scratch;
  const double h = m->opt.timestep, gravity = mju_norm3(m->opt.gravity);
  const int units = static_cast<int>(units_.size());
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
    RollStatically(h, scratch, s);
  }
  MoveLoads(h, gravity, at, s);
  for (int u = 0; u < units; ++u) {
    PlantState::Unit* unit = &s->unit[u];
    unit->tilt_rate = s->initialized > 1 ? (at.tilt[u] - unit->tilt) / h : 0;
    unit->tilt = at.tilt[u];
    const double bend = unit->gravity_x - unit->last_gravity_x;
    if (s->initialized > 1 && abs(at.motion[u].vx * bend) > kCrestMax * gravity * h) {
      s->left_range = static_cast<int>(s->left_range) | kCrest;
    }
    unit->last_gravity_x = unit->gravity_x;
  }
  s->initialized = 2;
  const PlanarVector<double>& lead = s->unit[0].acceleration;
  const double vx = s->vx + h * lead.x, vy = s->vy + h * lead.y;
  for (int u = 0; u < units; ++u) {
    PlantState::Unit* unit = &s->unit[u];
    unit->yaw_rate += h * unit->acceleration.yaw;
    if constexpr (kRolls) {
      unit->roll_rate += h * unit->acceleration.roll;
      unit->roll += h * unit->roll_rate;
    }
    if (u) unit->articulation += h * (unit->yaw_rate - s->unit[u - 1].yaw_rate);
  }
  // The velocity over ground turns against the unit's axes.
  const double turn = h * s->unit[0].yaw_rate;
  const auto [c, sn] = Rotation(turn);
  // Horizontal parts of the velocity along the road's plane.
  const double across = at.slope[0][1] * at.cosine[0] - at.slope[0][0] * at.sine[0];
  const double along = at.slope[0][0] * at.cosine[0] + at.slope[0][1] * at.sine[0];
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
