// Dead time of the brake lines: a ring of time-stamped samples, independent of the time step.
#ifndef IITS_MJ_PLUGIN_DEAD_TIME_H_
#define IITS_MJ_PLUGIN_DEAD_TIME_H_

namespace iits {

enum Circuit { kFront = 0, kDrive, kTrailer, kCircuits };

// Lives in the plugin's state. A reset (all zero) is a line without pressure. Samples are kept at
// least `spacing` apart, so that the ring covers (kSlots - 1) * spacing whatever the step is;
// between samples the signal, which is rate-limited, is taken as a straight line.
struct DeadTimeLine {
  static constexpr int kSlots = 16;

  double clock;      // own time: the user may set mjData.time at will [s]
  double last_used;  // clock when a supply last had pressure; 0 also when never
  double newest;     // slot of the newest sample
  double stamp[kSlots];
  double value[kSlots][kCircuits];

  void Push(const double supply[kCircuits], double h, double spacing) {
    clock += h;
    if (supply[kFront] > 0 || supply[kDrive] > 0 || supply[kTrailer] > 0) last_used = clock;
    int slot = static_cast<int>(newest);
    if (clock - stamp[slot] < spacing) return;
    slot = (slot + 1) % kSlots;
    newest = slot;
    stamp[slot] = clock;
    for (int i = 0; i < kCircuits; ++i) value[slot][i] = supply[i];
  }

  // Supply pressure of the circuit `delay` seconds before the end of a step of h that is not pushed
  // yet; `current` is the pressure at its end.
  double Look(int circuit, double delay, double h, double current) const {
    double wanted = clock + h - delay;
    double later_stamp = clock + h, later_value = current;
    int slot = static_cast<int>(newest);
    for (int i = 0; i < kSlots; ++i) {
      if (stamp[slot] <= wanted) {
        double span = later_stamp - stamp[slot];
        double share = span > 0 ? (wanted - stamp[slot]) / span : 1;
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

#endif  // IITS_MJ_PLUGIN_DEAD_TIME_H_
