// Loads that pitch and roll move between the wheels.
#include "plugin/plant/vehicle.h"

namespace iits {
namespace {

constexpr double kLoadLag = 0.1;  // [s] of the load transfer that has no state

}  // namespace

// Loads moved between the axles by pitch, with a lag in place of the springs' motion.
void Plant::MoveLoads(double h, double gravity, const Scratch& at, PlantState* s) const {
  const int units = static_cast<int>(units_.size());
  double moment[kUnitsMax];
  for (int u = 0; u < units; ++u) {
    const Unit& unit = units_[u];
    const PlantState::Unit& now = s->unit[u];
    moment[u] = at.pitch[u] - unit.pitch_inertia * (now.acceleration.x - now.gravity_x) +
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
  double link[kPlantAxlesMax], stiffness[kUnitsMax], moment[kUnitsMax];
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
    if (u + 1 < units) {
      const double c = at.motion[u + 1].cosine, sn = at.motion[u + 1].sine;
      const double side = sn * at.hitch[u + 1][0] + c * at.hitch[u + 1][1];
      moment[u] += (unit.hitch_height - unit.roll_axis) * side;
      // The unit behind leans on this one through the coupling's stiffness.
      const double k = units_[u + 1].law->roll_stiffness;
      const double whole = stiffness[u + 1] + k;
      stiffness[u] += c * c * k * (1 - k / whole);
      moment[u] += c * k / whole * moment[u + 1];
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

}  // namespace iits
