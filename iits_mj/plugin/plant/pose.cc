// The planar plant's state from and to MuJoCo's positions and velocities.
#include <cmath>
#include <cstring>

#include "plugin/plant/vehicle.h"

namespace iits {

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

}  // namespace iits
