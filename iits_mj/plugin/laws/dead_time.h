// Dead time of the brake lines: a ring of time-stamped samples, independent of the time step.
#ifndef IITS_MJ_PLUGIN_LAWS_DEAD_TIME_H_
#define IITS_MJ_PLUGIN_LAWS_DEAD_TIME_H_

#include "plugin/laws/number.h"

namespace iits {

enum Circuit { kFront = 0, kDrive, kTrailer, kCircuits };

// State of all lines; all zero: lines without pressure. Samples are at least `spacing` apart, so
// that the ring covers (kSlots - 1) * spacing at any step; between samples the signal, which is
// rate-limited, is a straight line.
template <class T>
struct DeadTimeLine {
  static constexpr int kSlots = 16;

  T clock;      // own time, since users may set the simulation's time [s]
  T last_used;  // clock when a supply last had pressure, 0 if none had
  T newest;     // slot of the newest sample
  T stamp[kSlots];
  T value[kSlots][kCircuits];

  void Push(const T supply[kCircuits], T h, T spacing) {
    clock += h;
    if (supply[kFront] > 0 || supply[kDrive] > 0 || supply[kTrailer] > 0) last_used = clock;
    int slot = Whole(newest, 0, kSlots - 1);
    if (clock - stamp[slot] < spacing) return;
    slot = (slot + 1) % kSlots;
    newest = slot;
    stamp[slot] = clock;
    for (int i = 0; i < kCircuits; ++i) value[slot][i] = supply[i];
  }

  // Supply pressure of a circuit `delay` seconds before the end of the present step of h, which is
  // not pushed yet; `current` is the pressure at its end.
  T Look(int circuit, T delay, T h, T current) const {
    const T wanted = clock + h - delay;
    T later_stamp = clock + h, later_value = current;
    int slot = Whole(newest, 0, kSlots - 1);
    for (int i = 0; i < kSlots; ++i) {
      if (stamp[slot] <= wanted) {
        const T span = later_stamp - stamp[slot];
        const T share = span > 0 ? (wanted - stamp[slot]) / span : T(1);
        return value[slot][circuit] + share * (later_value - value[slot][circuit]);
      }
      later_stamp = stamp[slot];
      later_value = value[slot][circuit];
      slot = (slot + kSlots - 1) % kSlots;
    }
    return later_value;
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_DEAD_TIME_H_
