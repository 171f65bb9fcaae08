// Forces of a tire: contact, relaxation, combined slip, aligning and rolling moments.
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "plugin/spatial.h"
#include "plugin/tire.h"

namespace iits {
namespace {

constexpr double kReferenceFriction = 0.8;  // surface on which the friction attributes hold
constexpr double kSlideSlip = 1.0;          // theoretical slip beyond which the tread just slides
constexpr double kLowSpeed = 2.0;           // [m/s] where the standstill damping has faded out
constexpr double kLowSpeedDamping = 6000;   // [N s/m] per tire
constexpr double kSpinWindUp = 0.01;        // [rad] of wheel rotation to full rolling resistance
constexpr double kSpinDamping = 0.08;       // [s] damping of that wind-up, over its stiffness
constexpr double kTurnBegin = 3, kTurnEnd = 9;  // normalised slip over which sliding sets in
constexpr double kRelaxationMin = 0.1;          // [m], of a lightly loaded tire
constexpr double kSpeedMin = 0.5;               // [m/s], in the slips that sensors read

// Magic Formula over normalised slip rho = K s / (mu Fz), with unit initial slope and unit peak;
// divided by rho, so that it is the share that is left of the linear force.
double MagicShare(double rho, double shape, double curvature) {
  if (rho == 0) return 1;
  double b = rho / shape;
  return std::sin(shape * std::atan(b - curvature * (b - std::atan(b)))) / rho;
}

}  // namespace

double Tire::ShareX(double rho) const {
  return MagicShare(rho, shape_longitudinal_, curvature_longitudinal_);
}

double Tire::ShareY(double rho) const {
  return MagicShare(rho, shape_lateral_, curvature_lateral_);
}

double Tire::InverseRelaxation(double relative) const {
  return 1 / (relaxation_lateral_ * std::pow(relative, relaxation_load_exponent_));
}

// What does not change from step to step. The grids' errors are below 3e-7 of the value for all
// attributes that are allowed, and below 3e-8 for those of the truck.
void Tire::Prepare() {
  nominal_deflection_ = nominal_load_ / vertical_stiffness_;
  inverse_nominal_load_ = 1 / (count_ * nominal_load_);
  inverse_saturation_ = 1 / load_saturation_;
  inverse_friction_x_ = 1 / friction_longitudinal_;
  inverse_friction_y_ = 1 / friction_lateral_;
  inverse_relaxation_x_ = 1 / relaxation_longitudinal_;
  stiffness_y_ = cornering_coefficient_ * (1 + inverse_saturation_ * inverse_saturation_);
  share_x_.Sample([this](double rho) { return ShareX(rho); }, 0, 8, 512);
  share_y_.Sample([this](double rho) { return ShareY(rho); }, 0, 8, 512);
  angle_.Sample([](double tangent) { return std::atan(tangent); }, -1, 1, 256);
  inverse_relaxation_y_.Sample([this](double load) { return InverseRelaxation(load); }, 0.125, 4,
                               992);
}

// Forces of two wheel ends at given theoretical slips. Similarity method: both slips are normalised
// by their own stiffness and friction, the force follows the resultant (Pacejka, "Tire and Vehicle
// Dynamics", 3rd ed., section 4.3.1). `relative` is the load over the nominal one.
Tire::Slip Tire::Combine(Pair sx, Pair sy, Pair load, Pair relative, Pair surface) const {
  const Pair fade = Max(1 - friction_load_slope_ * (relative - 1), Both(0.3));
  const Pair x = relative * inverse_saturation_;
  // K_y = c1 sin(2 atan(Fz / (c2 Fz0))) per tire, and sin(2 atan x) = 2x / (1 + x^2).
  const Pair linear_x = slip_stiffness_ * sx;
  const Pair cornering = stiffness_y_ / (1 + x * x);
  const Pair linear_y = cornering * sy;
  const Pair inverse_friction = 1 / (fade * surface);
  const Pair qx = linear_x * inverse_friction * inverse_friction_x_;
  const Pair qy = linear_y * inverse_friction * inverse_friction_y_;
  const Pair rho = Sqrt(qx * qx + qy * qy);
  Pair share_x, share_y;
  if (share_x_.Holds(rho)) {
    share_x = share_x_(rho);
    share_y = share_y_(rho);
  } else {
    share_x = Pair{ShareX(rho[0]), ShareX(rho[1])};
    share_y = Pair{ShareY(rho[0]), ShareY(rho[1])};
  }
  Pair fx = load * linear_x * share_x, fy = load * linear_y * share_y;
  const PairMask turns = rho > kTurnBegin;
  if (turns[0] | turns[1]) {  // seldom
    // The tread sticks with its stiffnesses, but slides straight against the sliding velocity.
    const Pair begun = (rho - kTurnBegin) * (1 / (kTurnEnd - kTurnBegin));
    const Pair sliding = Min(Max(begun, Both(0)), Both(1));
    const Pair limit = load * rho / (inverse_friction * Max(Sqrt(sx * sx + sy * sy), Both(1e-12)));
    fx += sliding * (limit * friction_longitudinal_ * share_x * sx - fx);
    fy += sliding * (limit * friction_lateral_ * share_y * sy - fy);
  }
  return {fx, fy, rho, cornering};
}

// Inverse of the lateral relaxation length [1/m].
Pair Tire::InverseRelaxation(Pair relative) const {
  const Pair inverse = inverse_relaxation_y_.Holds(relative)
                           ? inverse_relaxation_y_(relative)
                           : Pair{InverseRelaxation(relative[0]), InverseRelaxation(relative[1])};
  return Min(inverse, Both(1 / kRelaxationMin));
}

Pair Tire::SlipAngle(Pair tangent) const {
  return angle_.Holds(tangent) ? angle_(tangent)
                               : Pair{std::atan(tangent[0]), std::atan(tangent[1])};
}

// Where and how two wheels meet the road.
Tire::Contact Tire::Meet(const mjModel* m, const mjData* d, const Wheel& a, const Wheel& b,
                         Pair station_hint) const {
  Contact c;
  Pair center[3], axle[3], com[3], velocity[3], angular[3], linear[3];
  Gather(d->xpos + 3 * a.body, d->xpos + 3 * b.body, 1, center);
  Gather(d->xmat + 9 * a.hub + 1, d->xmat + 9 * b.hub + 1, 3, axle);
  // Velocity of the hub at the center; cvel is (angular, linear) about the tree's center of mass.
  Gather(d->subtree_com + 3 * a.root, d->subtree_com + 3 * b.root, 1, com);
  Gather(d->cvel + 6 * a.hub, d->cvel + 6 * b.hub, 1, angular);
  Gather(d->cvel + 6 * a.hub + 3, d->cvel + 6 * b.hub + 3, 1, velocity);
  for (int i = 0; i < 3; ++i) c.arm[i] = center[i] - com[i];
  Cross(angular, c.arm, linear);
  for (int i = 0; i < 3; ++i) linear[i] += velocity[i];

  const RoadPoints road = road_.Evaluate(m, center[0], center[1], station_hint);
  c.station = road.station;
  c.friction = road.friction;
  for (int i = 0; i < 3; ++i) c.normal[i] = road.up[i] * road.norm;
  c.distance = (center[2] - road.height) * c.normal[2];
  c.deflection = free_radius_ - c.distance;
  const Pair push =
      count_ * (vertical_stiffness_ * c.deflection - vertical_damping_ * Dot(linear, c.normal));
  c.stands = (c.deflection > 0) & (push > 1);  // false for NaN
  c.load = c.stands ? push : Both(1);

  // Frame: ex along the wheel's heading in the road plane, ey to the left, normal up.
  Cross(axle, road.up, c.ex);  // of any length, thus it need not wait for the unit normal
  const Pair scale = 1 / Sqrt(Max(Dot(c.ex, c.ex), Both(1e-12)));
  for (Pair& value : c.ex) value *= scale;
  Cross(c.normal, c.ex, c.ey);

  c.spin = Pair{d->qvel[a.dof], d->qvel[b.dof]};
  c.rolling_radius = rolling_radius_ + (nominal_deflection_ - c.deflection) * (1. / 3);
  c.speed = Dot(linear, c.ex);
  c.slip_vx = c.speed - c.rolling_radius * c.spin;
  // At the patch, `distance` below the center: (w x -distance n) ey = distance w ex.
  c.slip_vy = Dot(linear, c.ey) + c.distance * Dot(angular, c.ex);
  return c;
}

// Wrenches on two wheels, and their next states.
void Tire::PairForces(const mjModel* m, const mjData* d, const Wheel& a, const Wheel& b, State* sa,
                      State* sb, Wrench wrenches[2]) const {
  const double h = m->opt.timestep;
  const Contact c = Meet(m, d, a, b, Pair{sa->station, sb->station});

  // Relaxation: dz/dt = -Vs - |Vr| z / sigma, semi-implicit, so that it holds at standstill.
  const Pair transport = Abs(c.rolling_radius * c.spin);
  const Pair relative = c.load * inverse_nominal_load_;
  // A wheel end spins on its carcass spring: no stiffer than the step can carry (at 5 ms it is
  // felt).
  const Pair inverse_x =
      Min(Pair{a.carry, b.carry} / (h * h * c.load), Both(inverse_relaxation_x_));
  const Pair inverse_y = InverseRelaxation(relative);
  Pair zx = (Pair{sa->bristle_x, sb->bristle_x} - h * c.slip_vx) / (1 + h * transport * inverse_x);
  Pair zy = (Pair{sa->bristle_y, sb->bristle_y} - h * c.slip_vy) / (1 + h * transport * inverse_y);
  Pair sx = zx * inverse_x, sy = zy * inverse_y;
  const Pair square = sx * sx + sy * sy;
  const PairMask slides = square > kSlideSlip * kSlideSlip;
  if (slides[0] | slides[1]) {  // seldom
    // Beyond it the strain points against the sliding velocity: a locked wheel has no other sense
    // of direction, whatever its relaxation lengths.
    const Pair speed = Sqrt(c.slip_vx * c.slip_vx + c.slip_vy * c.slip_vy);
    const PairMask moves = speed > 1e-6;
    const Pair cut = kSlideSlip / (moves ? speed : Sqrt(square));
    sx = slides ? cut * (moves ? -c.slip_vx : sx) : sx;
    sy = slides ? cut * (moves ? -c.slip_vy : sy) : sy;
    zx = sx / inverse_x;
    zy = sy / inverse_y;
  }

  const Slip slip = Combine(sx, sy, c.load, relative, c.friction * (1 / kReferenceFriction));
  const Pair slide = Min(slip.saturation * (1. / 3), Both(1)), stick = 1 - slide;
  const Pair damping = count_ * kLowSpeedDamping * Max(1 - transport * (1 / kLowSpeed), Both(0)) *
                       stick * Min(relative, Both(1));
  const Pair fx = slip.fx - damping * c.slip_vx;
  const Pair fy = slip.fy - damping * c.slip_vy;
  // Aligning moment: pneumatic trail of the brush model, gone at full sliding.
  const Pair trail = pneumatic_trail_ * stick * stick * stick / (stick + slide * slide * (1. / 3));
  const Pair mz = -trail * slip.fy;
  // Rolling resistance as an elasto-plastic wind-up of the wheel, so that it can hold, too.
  const Pair resistance = rolling_resistance_ * c.load * c.rolling_radius;
  Pair wind_up = Pair{sa->bristle_spin, sb->bristle_spin} + h * c.spin;
  wind_up = Clamp(wind_up, kSpinWindUp);
  const Pair strained = Clamp((wind_up + kSpinDamping * c.spin) * (1 / kSpinWindUp), 1);
  // Forces act at the patch; the spin moment uses the rolling radius, which conserves energy. The
  // carcass deflects sideways by fy sigma_y / K_y, since a tire's lateral stiffness is K_y /
  // sigma_y (Pacejka, section 5.4.1), and takes the load along: a lever of sigma_y / (K_y / Fz).
  const Pair mx = (c.distance + 1 / (slip.cornering * inverse_y)) * fy;
  const Pair my = -resistance * strained - c.rolling_radius * fx;

  Pair force[3], moment[3];
  for (int i = 0; i < 3; ++i) force[i] = fx * c.ex[i] + fy * c.ey[i] + c.load * c.normal[i];
  Cross(c.arm, force, moment);
  for (int i = 0; i < 3; ++i) moment[i] += mx * c.ex[i] + my * c.ey[i] + mz * c.normal[i];

  const Pair inverse_speed = 1 / Max(Abs(c.speed), Both(kSpeedMin));
  const Pair slip_x = -c.slip_vx * inverse_speed,
             slip_angle = SlipAngle(-c.slip_vy * inverse_speed);
  const Pair signal[kSignals] = {fx, fy, c.load, mz, slip_x, slip_angle, c.deflection, c.friction};

  // In the air there is neither force nor signal, and the tread forgets.
  auto standing = [&c](Pair value) { return c.stands ? value : Both(0); };
  auto store = [sa, sb, &standing](double State::* member, Pair value) {
    value = standing(value);
    sa->*member = value[0];
    sb->*member = value[1];
  };
  sa->next_station = c.station[0];
  sb->next_station = c.station[1];
  store(&State::next_bristle_x, zx);
  store(&State::next_bristle_y, zy);
  store(&State::next_bristle_spin, wind_up);
  for (int i = 0; i < kSignals; ++i) {
    const Pair value = standing(signal[i]);
    sa->signal[i] = value[0];
    sb->signal[i] = value[1];
  }
  for (int i = 0; i < 3; ++i) {
    const Pair f = standing(force[i]), t = standing(moment[i]);
    for (int k = 0; k < 2; ++k) {
      wrenches[k].force[i] = f[k];
      wrenches[k].moment[i] = t[k];
    }
  }
}

// One pass, two wheels at a time. Each wheel's own degrees of freedom feel it at once; what all
// wheels hang on feels their sum, which is less than half of the products.
void Tire::Passive(const mjModel* m, mjData* d, int instance) const {
  State* states = reinterpret_cast<State*>(d->plugin_state + m->plugin_stateadr[instance]);
  const int count = static_cast<int>(wheels_.size());
  Wrench sum;
  for (int i = 0; i < count; i += 2) {
    const int j = std::min(i + 1, count - 1);  // the last of an odd number is its own partner
    Wrench wrench[2];
    PairForces(m, d, wheels_[i], wheels_[j], states + i, states + j, wrench);
    for (int k = i; k <= j; ++k) {
      wrench[k - i].Project(m, d, wheels_[k].dof, common_dof_, d->qfrc_passive);
      sum.Add(wrench[k - i]);
    }
  }
  if (common_dof_ >= 0) sum.Project(m, d, common_dof_, -1, d->qfrc_passive);
}

}  // namespace iits
