// Tire: vertical spring and damper, combined slip with relaxation lengths, aligning moment, rolling
// resistance. Every formula is in ../README.md.
#ifndef IITS_MJ_PLUGIN_LAWS_TIRE_H_
#define IITS_MJ_PLUGIN_LAWS_TIRE_H_

#include "plugin/laws/lookup.h"
#include "plugin/laws/number.h"
#include "plugin/laws/road.h"

namespace iits {

// Relaxation state of a wheel end.
template <class T>
struct TireBristles {
  T x, y;  // deflections over the relaxation lengths [m]
  T spin;  // wind-up of the rolling resistance [rad]
};

// Motion of a wheel end, world axes. `arm` leads from the point about which moments are taken to
// the wheel's center; the hub (the part that does not spin) moves with `velocity` at that point.
template <class T>
struct WheelMotion {
  T height;   // of the wheel's center [m]
  T arm[3];   // [m]
  T axle[3];  // unit vector along the spin axis
  T velocity[3], angular[3];
  T spin;   // [rad/s]
  T carry;  // stable limit of load over longitudinal relaxation length, times h^2 [N s2/m]
};

// Contact of a wheel end with the road: geometry, and velocities of the contact patch.
template <class T>
struct TireContact {
  decltype(T{} < T{}) touches;   // false: the wheel is in the air
  T ex[3], ey[3], normal[3];     // unit: ahead, to the left, up
  T distance, deflection, load;  // [m], [m], [N]; the load is 1 in the air
  T rolling_radius;              // [m]
  T speed, slip_vx, slip_vy;     // [m/s]
};

template <class T>
struct TireSlip {
  T fx, fy;      // forces [N]
  T saturation;  // normalized slip; full sliding near 3
  T cornering;   // cornering stiffness over load [1/rad]
};

// What a loss of pressure changes at a wheel end; an intact one has `tires` = count.
template <class T>
struct TirePuncture {
  T tires;          // that carry
  T drop;           // of the radius [m]
  T soft, dragged;  // factors on cornering stiffness and rolling resistance
};

// Result of a step; all zero in the air.
template <class T>
struct TireForces {
  static constexpr int kSignals = 8;
  T force[3], moment[3];  // on the wheel end [N], [N m]
  TireBristles<T> next;
  // Fx, Fy, Fz [N], Mz [N m], slip [1], slip angle [rad], deflection [m], friction [1]
  T signal[kSignals];
};

// Parameters and forces of the tires of a wheel end. `R` is the type of the parameters.
template <class R>
struct Tire {
  // Attributes.
  R count, free_radius, rolling_radius, vertical_stiffness, vertical_damping;
  R cornering_coefficient, pneumatic_trail, nominal_load, friction_lateral, friction_longitudinal;
  R friction_load_slope, shape_lateral, shape_longitudinal, curvature_lateral;
  R curvature_longitudinal, load_saturation, slip_stiffness, relaxation_lateral;
  R relaxation_load_exponent, relaxation_longitudinal, rolling_resistance;
  R rolling_resistance_load = 1, rolling_resistance_exponent = 1;
  // Derived by Prepare.
  R nominal_deflection, inverse_nominal_load, inverse_saturation, inverse_relaxation_x;
  R inverse_friction_x, inverse_friction_y, stiffness_y;
  Sampled<R> share_x, share_y;      // over normalized slip
  Sampled<R> inverse_relaxation_y;  // over relative load [1/m]
  Sampled<R> angle;                 // over its tangent
  Sampled<R> resistance_share;      // over the load per test load
  R per_test_load;                  // nominal load over test load

  // Computes the constants that depend on the attributes. The relative errors of the grids are
  // below 3e-7 for all allowed attributes, and below 3e-8 for those of the truck.
  void Prepare() {
    nominal_deflection = nominal_load / vertical_stiffness;
    inverse_nominal_load = 1 / (count * nominal_load);
    inverse_saturation = 1 / load_saturation;
    inverse_friction_x = 1 / friction_longitudinal;
    inverse_friction_y = 1 / friction_lateral;
    inverse_relaxation_x = 1 / relaxation_longitudinal;
    stiffness_y = cornering_coefficient * (1 + inverse_saturation * inverse_saturation);
    share_x.Sample([this](R rho) { return ShareX(rho); }, 0, 8, 512);
    share_y.Sample([this](R rho) { return ShareY(rho); }, 0, 8, 512);
    angle.Sample([](R tangent) { return atan(tangent); }, -1, 1, 256);
    per_test_load = nominal_load / rolling_resistance_load;
    if (rolling_resistance_exponent != 1) {
      resistance_share.Sample([this](R load) { return ResistanceShare(load); }, 0.125, 4, 992);
    }
    inverse_relaxation_y.Sample([this](R load) { return InverseRelaxation(load); }, 0.125, 4, 992);
  }

  // Greatest load over the longitudinal relaxation length, times step squared, for a spin inertia
  // of a wheel end: the integration of its carcass spring is stable.
  R Carry(R inertia) const {
    constexpr double kCarry = 0.9;  // greatest stiffness, times step squared over inertia
    return kCarry * inertia / (slip_stiffness * rolling_radius * rolling_radius);
  }

  // Of a twin, one tire goes flat and the other carries the load. A single tire runs on its rim.
  template <class T>
  TirePuncture<T> Puncture(T lost) const {
    lost = Clamp(lost, 0., 1.);
    const T twin = Fill<T>(count > 1), on_rim = lost * (1 - twin);
    TirePuncture<T> flat;
    flat.tires = count - twin * lost;
    flat.drop = kFlatDrop * on_rim;
    flat.soft = 1 - kFlatSoft * on_rim;
    flat.dragged = 1 + kFlatDrag * on_rim;
    return flat;
  }

  // Contact of a wheel end with the road below it.
  template <class T>
  TireContact<T> Meet(const WheelMotion<T>& wheel, const RoadPoint<T>& road,
                      const TirePuncture<T>& flat) const {
    TireContact<T> c;
    T linear[3];
    Cross(wheel.angular, wheel.arm, linear);
    for (int i = 0; i < 3; ++i) linear[i] += wheel.velocity[i];
    for (int i = 0; i < 3; ++i) c.normal[i] = road.up[i] * road.norm;
    c.distance = (wheel.height - road.height) * c.normal[2];
    c.deflection = (free_radius - flat.drop) - c.distance;
    const T push =
        flat.tires * (vertical_stiffness * c.deflection - vertical_damping * Dot(linear, c.normal));
    c.touches = (c.deflection > 0) & (push > 1);  // false for NaN
    c.load = c.touches ? push : Fill<T>(1);

    // ex along the wheel's heading in the road plane. `up` may have any length there, so that ex
    // does not wait for the unit normal.
    Cross(wheel.axle, road.up, c.ex);
    const T scale = 1 / sqrt(Max(Dot(c.ex, c.ex), 1e-12));
    for (T& value : c.ex) value *= scale;
    Cross(c.normal, c.ex, c.ey);

    c.rolling_radius =
        (rolling_radius - flat.drop) + (nominal_deflection - c.deflection) * (1. / 3);
    c.speed = Dot(linear, c.ex);
    c.slip_vx = c.speed - c.rolling_radius * wheel.spin;
    // At the patch, `distance` below the center: (w x -distance n) ey = distance w ex.
    c.slip_vy = Dot(linear, c.ey) + c.distance * Dot(wheel.angular, c.ex);
    return c;
  }

  // Forces at given theoretical slips. Similarity method: both slips are normalized by their own
  // stiffness and friction, the force follows the resultant (Pacejka, "Tire and Vehicle Dynamics",
  // 3rd ed., section 4.3.1). `relative` is the load over the nominal one, `surface` the friction
  // over that of the surface on which the attributes hold.
  template <class T>
  TireSlip<T> Combine(T sx, T sy, T load, T relative, T surface, T soft = Fill<T>(1)) const {
    const T fade = Max(1 - friction_load_slope * (relative - 1), 0.3);
    const T x = relative * inverse_saturation;
    // K_y = c1 sin(2 atan(Fz / (c2 Fz0))) per tire, and sin(2 atan x) = 2x / (1 + x^2).
    const T linear_x = slip_stiffness * sx;
    const T cornering = soft * stiffness_y / (1 + x * x);
    const T linear_y = cornering * sy;
    const T inverse_friction = 1 / (fade * surface);
    const T qx = linear_x * inverse_friction * inverse_friction_x;
    const T qy = linear_y * inverse_friction * inverse_friction_y;
    const T rho = sqrt(qx * qx + qy * qy);
    // Both grids have the same bounds.
    const bool held = share_x.Holds(rho);
    const T sampled_x = held ? share_x(rho) : Each<T>([&](int k) { return ShareX(Lane(rho, k)); });
    const T sampled_y = held ? share_y(rho) : Each<T>([&](int k) { return ShareY(Lane(rho, k)); });
    T fx = load * linear_x * sampled_x, fy = load * linear_y * sampled_y;
    if (Any(rho > kTurnBegin)) {  // seldom
      // The tread sticks with its stiffnesses, but slides straight against the sliding velocity.
      const T begun = (rho - kTurnBegin) * (1 / (kTurnEnd - kTurnBegin));
      const T sliding = Clamp(begun, 0., 1.);
      const T limit = load * rho / (inverse_friction * Max(sqrt(sx * sx + sy * sy), 1e-12));
      fx += sliding * (limit * friction_longitudinal * sampled_x * sx - fx);
      fy += sliding * (limit * friction_lateral * sampled_y * sy - fy);
    }
    return {fx, fy, rho, cornering};
  }

  // One step of a wheel end: forces, and the bristles at its end. `lost` is the lost share of a
  // tire's pressure.
  template <class T>
  TireForces<T> Step(const WheelMotion<T>& wheel, const RoadPoint<T>& road,
                     const TireBristles<T>& bristles, double h, T lost = T{}) const {
    const TirePuncture<T> flat = Puncture(lost);
    TireContact<T> c = Meet(wheel, road, flat);
    // The integrator's velocities are half a step older than its positions: the wheel's axes are
    // turned back to them.
    c.slip_vy += 0.5 * h * Dot(wheel.angular, c.normal) * c.speed;

    // Relaxation: dz/dt = -Vs - |Vr| z / sigma by the trapezoidal rule, which holds at standstill;
    // beyond h |Vr| / sigma = 2, where it would swing, more of it is implicit.
    const T transport = abs(c.rolling_radius * wheel.spin);
    const T relative = c.load * inverse_nominal_load * (count / flat.tires);
    // At a step of 5 ms, the bound by the step is active.
    const T inverse_x = Min(wheel.carry / (h * h * c.load), inverse_relaxation_x);
    const T inverse_y =
        Min(inverse_relaxation_y(relative, [this](auto at) { return InverseRelaxation(at); }),
            1 / kRelaxationMin);
    const T carried_x = h * transport * inverse_x, before_x = Min(0.5 * carried_x, 1.);
    const T carried_y = h * transport * inverse_y, before_y = Min(0.5 * carried_y, 1.);
    T zx = (bristles.x * (1 - before_x) - h * c.slip_vx) / (1 + (carried_x - before_x));
    T zy = (bristles.y * (1 - before_y) - h * c.slip_vy) / (1 + (carried_y - before_y));
    T sx = zx * inverse_x, sy = zy * inverse_y;
    const T square = sx * sx + sy * sy;
    const auto slides = square > kSlideSlip * kSlideSlip;
    if (Any(slides)) {  // seldom
      // The strain is opposite to the sliding velocity, as for a locked wheel, independently of the
      // relaxation lengths.
      const T speed = sqrt(c.slip_vx * c.slip_vx + c.slip_vy * c.slip_vy);
      const auto moves = speed > 1e-6;
      const T cut = kSlideSlip / (moves ? speed : sqrt(square));
      sx = slides ? cut * (moves ? -c.slip_vx : sx) : sx;
      sy = slides ? cut * (moves ? -c.slip_vy : sy) : sy;
      zx = sx / inverse_x;
      zy = sy / inverse_y;
    }

    const TireSlip<T> slip =
        Combine(sx, sy, c.load, relative, T(road.friction * (1 / kReferenceFriction)), flat.soft);
    const T slide = Min(slip.saturation * (1. / 3), 1.), stick = 1 - slide;
    const T damping = count * kLowSpeedDamping * Max(1 - transport * (1 / kLowSpeed), 0.) * stick *
                      Min(relative, 1.);
    const T fx = slip.fx - damping * c.slip_vx;
    const T fy = slip.fy - damping * c.slip_vy;
    // Aligning moment: pneumatic trail of the brush model, zero at full sliding.
    const T trail = pneumatic_trail * stick * stick * stick / (stick + slide * slide * (1. / 3));
    const T mz = -trail * slip.fy;
    // Rolling resistance as an elasto-plastic wind-up, so that it also holds a wheel at rest.
    T resistance = flat.dragged * rolling_resistance * c.load * c.rolling_radius;
    if (rolling_resistance_exponent != 1) {
      resistance *= resistance_share(relative * per_test_load,
                                     [this](auto load) { return ResistanceShare(load); });
    }
    const T wind_up = Clamp(bristles.spin + h * wheel.spin, -kSpinWindUp, kSpinWindUp);
    const T strained = Clamp((wind_up + kSpinDamping * wheel.spin) * (1 / kSpinWindUp), -1., 1.);
    // Forces act at the patch; the spin moment uses the rolling radius, which conserves energy. The
    // carcass deflects sideways by fy sigma_y / K_y, since a tire's lateral stiffness is K_y /
    // sigma_y (Pacejka, section 5.4.1), and takes the load along: a lever of sigma_y / (K_y / Fz).
    const T mx = (c.distance + 1 / (slip.cornering * inverse_y)) * fy;
    const T my = -resistance * strained - c.rolling_radius * fx;

    const T inverse_speed = 1 / Max(abs(c.speed), kSpeedMin);
    const T slip_x = -c.slip_vx * inverse_speed;
    const T slip_angle = angle(T(-c.slip_vy * inverse_speed), [](auto at) { return atan(at); });
    const T signal[] = {fx, fy, c.load, mz, slip_x, slip_angle, c.deflection, road.friction};

    // In the air, forces, signals and strains are zero.
    auto in_contact = [&c](T value) { return c.touches ? value : Fill<T>(0); };
    TireForces<T> out;
    T force[3], moment[3];
    for (int i = 0; i < 3; ++i) force[i] = fx * c.ex[i] + fy * c.ey[i] + c.load * c.normal[i];
    Cross(wheel.arm, force, moment);
    for (int i = 0; i < 3; ++i) {
      moment[i] += mx * c.ex[i] + my * c.ey[i] + mz * c.normal[i];
      out.force[i] = in_contact(force[i]);
      out.moment[i] = in_contact(moment[i]);
    }
    out.next = {in_contact(zx), in_contact(zy), in_contact(wind_up)};
    for (int i = 0; i < out.kSignals; ++i) out.signal[i] = in_contact(signal[i]);
    return out;
  }

 private:
  static constexpr double kReferenceFriction = 0.8;  // surface on which the attributes hold
  static constexpr double kSlideSlip = 1.0;  // theoretical slip beyond which the tread just slides
  static constexpr double kLowSpeed = 2.0;   // [m/s] where the standstill damping has faded out
  static constexpr double kLowSpeedDamping = 6000;  // [N s/m] per tire
  static constexpr double kSpinWindUp = 0.01;  // [rad] of wheel rotation to full rolling resistance
  static constexpr double kSpinDamping = 0.08;  // [s] damping of that wind-up, over its stiffness
  static constexpr double kTurnBegin = 3, kTurnEnd = 9;  // normalized slip: sliding sets in
  static constexpr double kRelaxationMin = 0.1;          // [m], of a lightly loaded tire
  static constexpr double kSpeedMin = 0.5;               // [m/s], in the slips that sensors read
  // A flat single tire, estimated: loss of radius [m], of cornering stiffness, more resistance.
  static constexpr double kFlatDrop = 0.1, kFlatSoft = 0.7, kFlatDrag = 9;

  // Share of the linear force that is left at normalized slip rho = K s / (mu Fz): Magic Formula
  // with unit initial slope and unit peak, over rho.
  template <class T>
  static T MagicShare(T rho, R shape, R curvature) {
    if (rho == 0) return 1;
    const T b = rho / shape;
    return sin(shape * atan(b - curvature * (b - atan(b)))) / rho;
  }
  template <class T>
  T ShareX(T rho) const {
    return MagicShare(rho, shape_longitudinal, curvature_longitudinal);
  }
  template <class T>
  T ShareY(T rho) const {
    return MagicShare(rho, shape_lateral, curvature_lateral);
  }
  // Rolling resistance at a load per test load, over that at the test load.
  template <class T>
  T ResistanceShare(T load) const {
    return pow(load, rolling_resistance_exponent - 1);
  }
  // Inverse of the lateral relaxation length at a relative load [1/m].
  template <class T>
  T InverseRelaxation(T relative) const {
    return 1 / (relaxation_lateral * pow(relative, relaxation_load_exponent));
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_TIRE_H_
