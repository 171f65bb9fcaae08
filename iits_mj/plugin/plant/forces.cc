// Forces of a step: tires, weights, air, sprung masses and couplings.
#include <cmath>

#include "plugin/plant/vehicle.h"
#include "plugin/plugin.h"

namespace iits {
namespace {

constexpr double kStopStiffness = 2e6;  // [N m/rad] of a coupling's stop in yaw, estimated
constexpr double kStopDamping = 1e5;    // [N m s/rad]
constexpr double kRollMax = 0.17;       // [rad] up to which roll counts as small

}  // namespace

// Forces and next states of powertrain, steering and brakes, by their plugins. The brakes feel the
// forward speeds of the hubs.
void Plant::Actuate(const mjModel* m, mjData* d, Scratch* at) const {
  double hub_speed[2 * kPlantAxlesMax];
  for (size_t a = 0; a < axles_.size(); ++a) {
    const Axle& axle = axles_[a];
    const PlanarMotion<double>& v = at->motion[axle.unit];
    const double vy = v.vy + axle.x * v.yaw_rate + units_[axle.unit].coupling * v.roll_rate;
    for (int side = 0; side < 2; ++side) {
      const double y = side ? -axle.half_track : axle.half_track;
      double speed = v.vx - y * v.yaw_rate;
      if (axle.steered) {
        const double angle = d->qpos[axle.knuckle_qpos[side]];
        at->steer[a][side] = angle;
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
  at->shaft_torque = d->actuator_force[shaft_force_];
  at->pitman_angle = reinterpret_cast<const SteeringStates*>(d->plugin_state +
                                                             m->plugin_stateadr[steering_instance_])
                         ->now.pitman_angle;
}

// Forces of a unit's tires, and of its static loads along the road's plane.
void Plant::AddTires(const mjModel* m, mjData* d, int u, PlantState* s, Scratch* at) const {
  const double h = m->opt.timestep;
  const Unit& unit = units_[u];
  const PlanarMotion<double>& v = at->motion[u];
  PlanarVector<double> q = {0, 0, 0, 0};
  double loads = 0, sx = 0, sy = 0, tire_x = 0, resistance = 0;
  const double base = v.vy + unit.coupling * v.roll_rate;  // of the roll axis
  for (int a = unit.first_axle; a < unit.end_axle; ++a) {
    const Axle& axle = axles_[a];
    const double c = at->cosine[u], sn = at->sine[u], t = axle.half_track;
    TireState* const state[2] = {reinterpret_cast<TireState*>(d->plugin_state + axle.state[0]),
                                 reinterpret_cast<TireState*>(d->plugin_state + axle.state[1])};
    const double px = at->x[u] + c * axle.x, py = at->y[u] + sn * axle.x;
    RoadPoint<Pair> road =
        road_.Evaluate(m->numeric_data + road_address_, Pair{px - sn * t, px + sn * t},
                       Pair{py + c * t, py - c * t}, Pair{state[0]->station, state[1]->station});
    const Pair up[2] = {road.up[0] * road.norm, road.up[1] * road.norm};
    const double normal = 0.5 * (road.norm[0] + road.norm[1]);

    // Loads, of which no wheel can have less than nothing.
    const double load = Max(0., normal * axle.static_load + s->axle[a].pitch_load);
    const double moved = Clamp(s->axle[a].roll_moment / (2 * t), -0.5 * load, 0.5 * load);
    const Pair wheel_load = {0.5 * load - moved, 0.5 * load + moved};
    if (axle.rate > 0 && abs(moved) >= 0.5 * load) at->left_range |= kWheelLift;
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
        wheel.axle[0][side] = -std::sin(at->steer[a][side]);
        wheel.axle[1][side] = std::cos(at->steer[a][side]);
        wheel.angular[2][side] = d->qvel[axle.knuckle[side]];
      }
    } else {
      wheel.axle[1] = Fill<Pair>(1);
    }
    wheel.velocity[0] = v.vx - Pair{t, -t} * v.yaw_rate;
    // The roll center moves sideways with the body, the tires' contacts with the axle's roll.
    wheel.velocity[1] =
        Fill<Pair>(base + axle.x * v.yaw_rate + (unit.roll_axis - axle.roll_center) * v.roll_rate +
                   axle.roll_center * s->axle[a].roll_rate);
    wheel.velocity[2] = Fill<Pair>(0);
    wheel.angular[2] += Fill<Pair>(v.yaw_rate);
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
    if (axle.target >= 0) steering_->Targets(axle.target, at->pitman_angle, targets);
    for (int side = 0; side < 2; ++side) {
      TireState* to = state[side];
      to->next_station = road.station[side];
      to->next_bristles = {f.next.x[side], f.next.y[side], f.next.spin[side]};
      for (int i = 0; i < f.kSignals; ++i) to->signal[i] = f.signal[i][side];
      const int dof = axle.spin[side];
      const double torque =
          spin_moment[side] + d->qfrc_passive[dof] + axle.shaft[side] * at->shaft_torque;
      d->qacc[dof] = torque * axle.inverse_inertia[side];
      if (axle.steered) {
        // As MuJoCo's integrator `implicitfast`: implicit in the damping.
        const double k = axle.knuckle_stiffness, angle = at->steer[a][side];
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
    q.yaw += axle.x * left - t * (f.force[0][0] + wx[0] - f.force[0][1] - wx[1]) + f.moment[2][0] +
             f.moment[2][1];
    at->lateral[a] = fy;
    // The law's moments are about the wheels' centers; this one is about the road.
    const Pair tilting = f.moment[0] * wheel.axle[1] - f.moment[1] * wheel.axle[0] -
                         wheel.height * (f.force[0] * wheel.axle[0] + f.force[1] * wheel.axle[1]);
    const Pair rolling =
        spin_moment + wheel.height * (f.force[0] * wheel.axle[1] - f.force[1] * wheel.axle[0]);
    // With the gyroscopic moment of the wheels.
    const Pair spin = wheel.spin / Pair{axle.inverse_inertia[0], axle.inverse_inertia[1]};
    at->overturning[a] = tilting[0] + tilting[1] + v.yaw_rate * (spin[0] + spin[1]);
    resistance += rolling[0] + rolling[1];
  }
  q.roll = unit.coupling * q.y;
  at->force[u] = q;
  at->pitch[u] = resistance - unit.front_height * tire_x;
  at->slope[u][0] = sx;
  at->slope[u][1] = sy;
  at->load[u] = loads;
}

// The road's slope below a unit: below its axles and its coupling, by their loads.
void Plant::MeasureSlope(const mjModel* m, int u, PlantState* s, Scratch* at) const {
  const Unit& unit = units_[u];
  const double gravity = mju_norm3(m->opt.gravity);
  double total = at->load[u];
  at->tilt[u] =
      total > 0 ? (at->slope[u][0] * at->sine[u] - at->slope[u][1] * at->cosine[u]) / total : 0;
  if (u) {
    at->slope[u][0] += unit.coupling_load * at->slope[u - 1][0];
    at->slope[u][1] += unit.coupling_load * at->slope[u - 1][1];
    total += unit.coupling_load;
  }
  if (total > 0) {
    at->slope[u][0] /= total;
    at->slope[u][1] /= total;
  }
  // Of the weights, as a field along the unit's axes.
  s->unit[u].gravity_x =
      gravity * (at->slope[u][0] * at->cosine[u] + at->slope[u][1] * at->sine[u]);
  s->unit[u].gravity_y = -gravity * at->tilt[u];
}

void Plant::AddAir(const mjModel* m, int u, Scratch* at) const {
  const Unit& unit = units_[u];
  const PlanarMotion<double>& v = at->motion[u];
  PlanarVector<double>* q = &at->force[u];
  at->air_roll[u] = 0;
  const double wind_x = m->opt.wind[0] * at->cosine[u] + m->opt.wind[1] * at->sine[u];
  const double wind_y = m->opt.wind[1] * at->cosine[u] - m->opt.wind[0] * at->sine[u];
  for (const Unit::Air& air : unit.air) {
    const double lever = air.height - unit.roll_axis;
    const double ahead = v.vx - wind_x;
    const double left = v.vy + air.x * v.yaw_rate + (unit.coupling - lever) * v.roll_rate - wind_y;
    double force[2];
    air.law->Force(std::sqrt(ahead * ahead + left * left), ahead, left, force);
    q->x += force[0];
    q->y += force[1];
    q->yaw += air.x * force[1];
    q->roll += (unit.coupling - lever) * force[1];
    at->air_roll[u] -= lever * force[1];
    at->pitch[u] += (air.height - unit.front_height) * force[0];
  }
}

// Roll moment of a sprung mass whose roll is a state: weights, springs and the axles' roll centers.
void Plant::AddRoll(double h, int u, PlantState* s, Scratch* at) const {
  const Unit& unit = units_[u];
  PlanarVector<double>* q = &at->force[u];
  const PlantState::Unit& last = s->unit[u];
  // Bounded, so that a truck that has rolled over stays finite.
  q->roll += unit.tilting * (Clamp(last.roll, -1., 1.) + at->tilt[u]);
  for (int a = unit.first_axle; a < unit.end_axle; ++a) {
    const Axle& axle = axles_[a];
    PlantState::Axle* to = &s->axle[a];
    const double felt = last.acceleration.y + axle.x * last.acceleration.yaw +
                        unit.coupling * last.acceleration.roll - last.gravity_y;
    const double transmitted = at->lateral[a] - axle.mass * felt;
    const double link =
        axle.roll_center * transmitted + axle.height * axle.mass * felt + at->overturning[a];
    // The axle hangs between tires, springs and dampers; it has no inertia in roll.
    const double spring = axle.roll_stiffness * last.roll + axle.roll_damping * last.roll_rate;
    const double whole = axle.roll_stiffness + axle.tire_roll_stiffness;
    to->roll_rate = (spring + link - whole * to->roll) / (axle.roll_damping + h * whole);
    const double most = axle.half_track * Max(0., axle.static_load + to->pitch_load);
    const double moment =
        Clamp(axle.tire_roll_stiffness * (to->roll + h * to->roll_rate), -most, most);
    q->roll -= moment - link + (axle.roll_center - unit.roll_axis) * transmitted;
    to->roll_moment = moment;
  }
  if (abs(last.roll) > kRollMax) at->left_range |= kRollAngle;
}

// Moments of the couplings: friction and stops in yaw, elastic in roll.
void Plant::AddCouplings(double h, mjData* d, const PlantState& s, Scratch* at) const {
  for (size_t u = 1; u < units_.size(); ++u) {
    const Unit& unit = units_[u];
    const PlantState::Unit &own = s.unit[u], &ahead = s.unit[u - 1];
    FifthWheelState* state = reinterpret_cast<FifthWheelState*>(d->plugin_state + unit.law_state);
    const double rate = own.yaw_rate - ahead.yaw_rate;
    state->next_wind_up = state->wind_up;
    double yaw = unit.law->YawMoment(rate, h, &state->next_wind_up);
    if (unit.limited) {
      const double beyond = own.articulation - Clamp(own.articulation, unit.yaw_min, unit.yaw_max);
      if (beyond != 0) {
        at->left_range |= kArticulation;
        yaw -= kStopStiffness * beyond + kStopDamping * rate;
      }
    }
    at->force[u].yaw += yaw;
    at->force[u - 1].yaw -= yaw;
    if (!rolls_) continue;
    const double c = at->motion[u].cosine;
    const double roll =
        unit.law->RollMoment(own.roll + at->tilt[u] - c * (ahead.roll + at->tilt[u - 1]),
                             own.roll_rate - c * ahead.roll_rate);
    at->coupling_roll[u] = roll;
    at->force[u].roll += roll;
    at->force[u - 1].roll -= c * roll;
  }
}

}  // namespace iits
