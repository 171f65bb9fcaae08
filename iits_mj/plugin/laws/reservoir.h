// Compressed air: a reservoir per circuit, compressor with governor, and spring brakes at low
// pressure.
#ifndef IITS_MJ_PLUGIN_LAWS_RESERVOIR_H_
#define IITS_MJ_PLUGIN_LAWS_RESERVOIR_H_

#include "plugin/laws/wheel_brake.h"

namespace iits {

template <class T>
struct ReservoirState {
  T pressure[kCircuits];  // above the atmosphere [Pa]
  T pumping;              // 1: the governor has cut the compressor in
};

// Air is counted as pressure times volume [Pa m3] at one temperature.
template <class T>
struct Reservoirs {
  // Attributes.
  T volume[kCircuits];  // 0 for a circuit without wheels
  T displacement, cut_in, cut_out, spring_begin, spring_full;

  // Charged to the cut-out pressure.
  void Fill(ReservoirState<T>* s) const {
    for (T& pressure : s->pressure) pressure = cut_out;
    s->pumping = 0;
  }

  void Draw(int circuit, T air, ReservoirState<T>* s) const {
    if (air == 0) return;
    s->pressure[circuit] = Max(0.0, s->pressure[circuit] - air / volume[circuit]);
  }

  // Runs the compressor for h at an engine speed [rad/s].
  void Pump(T engine_speed, T h, ReservoirState<T>* s) const {
    T lack = 0;  // of air below the cut-out pressure
    bool low = false;
    for (int i = 0; i < kCircuits; ++i) {
      lack += volume[i] * Max(0.0, cut_out - s->pressure[i]);
      low = low || s->pressure[i] < cut_in;
    }
    if (low) s->pumping = 1;
    if (s->pumping == 0) return;
    const T delivered = kAtmosphere * displacement * Max(0.0, engine_speed) * h;
    // The air is shared in proportion to the deficits, so that all reservoirs fill simultaneously.
    const T share = delivered >= lack ? T(1) : delivered / lack;
    for (T& pressure : s->pressure) pressure += share * Max(0.0, cut_out - pressure);
    if (share == 1) s->pumping = 0;
  }

  // Share of the spring brakes that low pressure applies. Those of the towing vehicle depend on its
  // circuit with the higher pressure, those of the trailer on the trailer's circuit.
  T Springs(int circuit, const ReservoirState<T>& s) const {
    const T pressure =
        circuit == kTrailer ? s.pressure[kTrailer] : Max(s.pressure[kFront], s.pressure[kDrive]);
    return Clamp((spring_begin - pressure) / (spring_begin - spring_full), 0.0, 1.0);
  }
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_RESERVOIR_H_
