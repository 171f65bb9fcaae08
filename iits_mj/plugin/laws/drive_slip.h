// Slip control of the driven wheels by engine and brakes: traction control (ASR) and drag-torque
// control.
#ifndef IITS_MJ_PLUGIN_LAWS_DRIVE_SLIP_H_
#define IITS_MJ_PLUGIN_LAWS_DRIVE_SLIP_H_

#include "plugin/laws/number.h"

namespace iits {

// A share that a slip control takes away, 0 to 1.
template <class T>
struct SlipRelief {
  T slip;       // behind the lag of the differentiator
  T ahead;      // slip on which the control acted last
  T share;      // taken away
  T releasing;  // 1: from the slip at which it begins until the wheels roll
};

template <class T>
struct DriveSlipState {
  SlipRelief<T> drag, traction;
};

// Slips of the driven wheels: positive if the driveline brakes the wheel, negative if it spins.
template <class T>
struct DriveSlip {
  T least = kInfinity, greatest = -kInfinity, sum = 0;
  int count = 0;

  void Add(T slip) {
    least = Min(least, slip);
    greatest = Max(greatest, slip);
    sum += slip;
    ++count;
  }
};

// The engine's part takes torque away until the wheels roll, and returns it slowly. A control that
// holds a slip would hold the wheels where they give no side force, and the truck would jack-knife.
template <class T>
struct SlipReliefLaw {
  // Attributes.
  T begin, end;    // slips at which it begins and ends
  T release_time;  // in which the whole torque goes [s]
  T return_time;   // in which it returns [s]

  // A change of direction counts from the moment within the step at which the slip crosses the
  // limit, so that the result does not depend on the step.
  T Update(T ahead, T h, SlipRelief<T>* s) const {
    const T before = s->releasing, past = s->ahead;
    if (ahead > begin) s->releasing = 1;
    if (ahead < end) s->releasing = 0;
    T since = 0;  // share of the step before the change
    if (s->releasing != before) {
      const T limit = s->releasing != 0 ? begin : end;
      since = Clamp((limit - past) / (ahead - past), 0.0, 1.0);
    }
    s->ahead = ahead;
    const T on = since * before + (1 - since) * s->releasing;
    s->share = Clamp(s->share + h * (on / release_time - (1 - on) / return_time), 0.0, 1.0);
    return s->share;
  }
};

template <class T>
struct DriveSlipControl {
  // Attributes.
  SlipReliefLaw<T> drag, traction;
  T lag, lead;  // of the slip's rate, with which a control acts ahead [s]
  // Traction control below `low_speed`, where a start needs all the friction: it holds the slip at
  // `traction.begin` by a PI control, whose gain is 1 / `range`.
  T low_speed, hold_time, range;
  // Brakes stop a single spinning wheel up to `brake_speed` [m/s], with `brake_pressure` [Pa] at a
  // slip that is `range` greater than that of the slowest wheel.
  T brake_speed, brake_pressure;

  // Share of the drag torque to take away: engine brake and retarder release up to one half, the
  // engine pulls against its own drag above. `slip` is the greatest of the wheels. At low speed
  // the jerk of a gear change would look like it.
  T Drag(T slip, T speed, T h, DriveSlipState<T>* s) const {
    const T ahead = Ahead(slip, h, &s->drag.slip);
    return drag.Update(abs(speed) < low_speed ? T(0) : ahead, h, &s->drag);
  }

  // Share of the accelerator to cut. While the brakes stop single wheels, the mean slip counts,
  // which is that of the propeller shaft. Above, the fastest wheel counts.
  T Traction(const DriveSlip<T>& slip, T speed, T h, DriveSlipState<T>* s) const {
    SlipRelief<T>* cut = &s->traction;
    const T spin = -(abs(speed) < brake_speed ? slip.sum / slip.count : slip.least);
    const T ahead = Ahead(spin, h, &cut->slip);
    if (abs(speed) >= low_speed) return traction.Update(ahead, h, cut);
    const T error = (spin - traction.begin) / range;
    cut->share = Clamp(cut->share + h * error / hold_time, 0.0, 1.0);
    cut->releasing = 0;
    return Clamp(cut->share + error, 0.0, 1.0);
  }

  // Pressure that brakes a spinning wheel [Pa]; open differentials then drive the other wheels.
  T Pressure(const DriveSlip<T>& slip, T wheel_slip, T speed) const {
    if (!(abs(speed) < brake_speed)) return 0;
    const T ahead = Min(slip.greatest - wheel_slip, -wheel_slip);
    return brake_pressure * Clamp((ahead - traction.end) / range, 0.0, 1.0);
  }

 private:
  // Slip at the end of the step, and a lead ahead of that.
  T Ahead(T slip, T h, T* lagged) const {
    const T past = *lagged;
    *lagged += LagShare(h, lag) * (slip - past);
    return slip + (lead + 1.5 * h) * (slip - 0.5 * (past + *lagged)) / lag;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_DRIVE_SLIP_H_
