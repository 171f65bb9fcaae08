// Planar motion of a chain of units (motor vehicle, trailers, dollies), each hinged to the one
// ahead, optionally with the roll of each unit's sprung mass about its roll axis.
//
// A unit moves with the velocity (vx, vy) of its front coupling point, along its own axes, the yaw
// rate r and the roll rate p; the motor vehicle's point is its origin. With q' = (vx, vy, r, p), an
// element at distance x behind the point (x < 0) and height h above the roll axis moves with
// (vx, vy + x r + (c - h) p), c the height of the coupling above the axis. Lagrange's equations for
// the inertial acceleration a of the point, M (ax, ay, r', p') = Q + B + hitch forces, are solved
// from the last unit to the first: yaw and roll of a unit are eliminated (LDL'), what is left is a
// 2 x 2 inertia that the unit ahead feels at its hitch (Featherstone, "Rigid Body Dynamics
// Algorithms", ch. 7). The cost grows linearly with the units.
#ifndef IITS_MJ_PLUGIN_LAWS_PLANAR_H_
#define IITS_MJ_PLUGIN_LAWS_PLANAR_H_

#include "plugin/laws/number.h"

namespace iits {

inline constexpr int kUnitsMax = 8;

// Inertia of a unit: sums over its elements, with d = c - h the lever of roll.
template <class T>
struct PlanarInertia {
  T mass;     // [kg]
  T x, d;     // sums of m x and of m d [kg m]
  T xx;       // of m x^2, and the yaw inertia [kg m2]
  T xd;       // of m x d, plus the sprung mass's Ixz = -S(m x z) [kg m2]
  T dd;       // of m d^2, and the roll inertia of the sprung mass [kg m2]
  T hitch_x;  // place of the next unit's coupling [m]
  T hitch_d;  // its lever of roll [m]
};

template <class T>
struct PlanarMotion {
  T vx, vy, yaw_rate, roll_rate;
  T cosine, sine;  // of the yaw against the unit ahead; not used for the first unit
};

// Generalized forces, or accelerations (inertial ones of the coupling point).
template <class T>
struct PlanarVector {
  T x, y, yaw, roll;
};

// Velocity of the hitch of the next unit, along this unit's axes.
template <class T>
void HitchVelocity(const PlanarInertia<T>& unit, const PlanarMotion<T>& at, T out[2]) {
  out[0] = at.vx;
  out[1] = at.vy + unit.hitch_x * at.yaw_rate + unit.hitch_d * at.roll_rate;
}

// Accelerations of `count` units from generalized forces; `hitch` receives the force (x, y) of the
// unit ahead on each unit, along its own axes.
template <bool kRolls, class T>
void Accelerate(const PlanarInertia<T>* units, const PlanarMotion<T>* motion,
                const PlanarVector<T>* forces, int count, PlanarVector<T>* acceleration,
                T (*hitch)[2]) {
  // What is left of the eliminated rows of each unit.
  struct Rows {
    T roll_inverse, roll_yaw, roll_y, roll_x, roll_force;  // over the pivot of roll
    T yaw_inverse, yaw_y, yaw_x, yaw_force;                // over the pivot of yaw
    T xx, xy, yy, fx, fy;                                  // inertia and force at the coupling
  };
  Rows rows[kUnitsMax];
  for (int i = count - 1; i >= 0; --i) {
    const PlanarInertia<T>& u = units[i];
    const T r = motion[i].yaw_rate, p = kRolls ? motion[i].roll_rate : T(0);
    T xx = u.mass, xy = 0, yy = u.mass, ry = u.x, rx = 0, rr = u.xx;
    T py = u.d, px = 0, pr = u.xd, pp = u.dd;
    // The coupling's acceleration is inertial: what is left of B is the centripetal part.
    T fx = forces[i].x + r * (u.x * r + (kRolls ? u.d * p : T(0)));
    T fy = forces[i].y, fr = forces[i].yaw, fp = forces[i].roll;
    if (i + 1 < count) {
      const Rows& n = rows[i + 1];
      const T c = motion[i + 1].cosine, s = motion[i + 1].sine;
      // Inertia and force of the next unit along this unit's axes.
      const T cross = c * s * (n.xx - n.yy), both = 2 * c * s * n.xy;
      const T axx = c * c * n.xx + s * s * n.yy - both;
      const T ayy = s * s * n.xx + c * c * n.yy + both;
      const T axy = cross + (c * c - s * s) * n.xy;
      const T x = u.hitch_x, d = kRolls ? u.hitch_d : T(0);
      const T k = -r * (x * r + d * p);
      const T gx = c * n.fx - s * n.fy - axx * k, gy = s * n.fx + c * n.fy - axy * k;
      xx += axx;
      xy += axy;
      yy += ayy;
      ry += x * ayy;
      rx += x * axy;
      rr += x * x * ayy;
      fx += gx;
      fy += gy;
      fr += x * gy;
      if constexpr (kRolls) {
        py += d * ayy;
        px += d * axy;
        pr += d * x * ayy;
        pp += d * d * ayy;
        fp += d * gy;
      }
    }
    Rows& out = rows[i];
    if constexpr (kRolls) {
      out.roll_inverse = 1 / pp;
      out.roll_yaw = pr * out.roll_inverse;
      out.roll_y = py * out.roll_inverse;
      out.roll_x = px * out.roll_inverse;
      out.roll_force = fp * out.roll_inverse;
      rr -= pr * out.roll_yaw;
      ry -= pr * out.roll_y;
      rx -= pr * out.roll_x;
      yy -= py * out.roll_y;
      xy -= py * out.roll_x;
      xx -= px * out.roll_x;
      fr -= pr * out.roll_force;
      fy -= py * out.roll_force;
      fx -= px * out.roll_force;
    }
    out.yaw_inverse = 1 / rr;
    out.yaw_y = ry * out.yaw_inverse;
    out.yaw_x = rx * out.yaw_inverse;
    out.yaw_force = fr * out.yaw_inverse;
    out.yy = yy - ry * out.yaw_y;
    out.xy = xy - ry * out.yaw_x;
    out.xx = xx - rx * out.yaw_x;
    out.fy = fy - ry * out.yaw_force;
    out.fx = fx - rx * out.yaw_force;
  }
  const Rows& first = rows[0];
  const T inverse = 1 / (first.xx * first.yy - first.xy * first.xy);
  T ax = inverse * (first.yy * first.fx - first.xy * first.fy);
  T ay = inverse * (first.xx * first.fy - first.xy * first.fx);
  for (int i = 0; i < count; ++i) {
    const Rows& n = rows[i];
    const PlanarMotion<T>& at = motion[i];
    if (i > 0) {
      const T x = ax, y = ay;
      ax = at.cosine * x + at.sine * y;
      ay = at.cosine * y - at.sine * x;
    }
    hitch[i][0] = i ? n.xx * ax + n.xy * ay - n.fx : T(0);
    hitch[i][1] = i ? n.xy * ax + n.yy * ay - n.fy : T(0);
    const T yaw = n.yaw_force - n.yaw_x * ax - n.yaw_y * ay;
    T roll = 0;
    if constexpr (kRolls) roll = n.roll_force - n.roll_x * ax - n.roll_y * ay - n.roll_yaw * yaw;
    acceleration[i] = {ax, ay, yaw, roll};
    // Of the next unit's hitch, along this unit's axes.
    const PlanarInertia<T>& u = units[i];
    const T p = kRolls ? at.roll_rate : T(0);
    ax -= at.yaw_rate * (u.hitch_x * at.yaw_rate + u.hitch_d * p);
    ay += u.hitch_x * yaw + u.hitch_d * roll;
  }
}

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_PLANAR_H_
