// Aerodynamics: drag and side force at a center of pressure.
#ifndef IITS_MJ_PLUGIN_LAWS_AERODYNAMICS_H_
#define IITS_MJ_PLUGIN_LAWS_AERODYNAMICS_H_

#include "plugin/laws/number.h"

namespace iits {

template <class T>
struct Aerodynamics {
  // Attributes; an area includes its coefficient.
  T density, drag_area, side_area;

  // Force along the body's x and y axes [N]: F = -1/2 density |v| v_i area_i, with `forward` and
  // `left` the body's velocity relative to the air along these axes, `speed` its magnitude [m/s].
  void Force(T speed, T forward, T left, T force[2]) const {
    force[0] = -0.5 * density * drag_area * speed * forward;
    force[1] = -0.5 * density * side_area * speed * left;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_AERODYNAMICS_H_
