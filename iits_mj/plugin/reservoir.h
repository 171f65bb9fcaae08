// Compressed air: a reservoir per circuit, compressor with governor, and the spring brakes that a
// lack of pressure applies.
#ifndef IITS_MJ_PLUGIN_RESERVOIR_H_
#define IITS_MJ_PLUGIN_RESERVOIR_H_

#include <mujoco/mujoco.h>

#include <algorithm>

#include "plugin/dead_time.h"
#include "plugin/wheel_brake.h"

namespace iits {

struct ReservoirState {
  double pressure[kCircuits];  // above the atmosphere [Pa]
  double pumping;              // 1: the governor has cut the compressor in
};

// Air is counted as pressure times volume [Pa m3] at one temperature.
class Reservoirs {
 public:
  bool Read(const mjModel* m, int instance);  // false after a warning

  // Charged to the cut-out pressure.
  void Fill(ReservoirState* s) const {
    std::fill(s->pressure, s->pressure + kCircuits, cut_out_);
    s->pumping = 0;
  }

  void Draw(int circuit, double air, ReservoirState* s) const {
    s->pressure[circuit] = std::max(0.0, s->pressure[circuit] - air / volume_[circuit]);
  }

  // The compressor at this speed of the engine [rad/s] for h.
  void Pump(double engine_speed, double h, ReservoirState* s) const {
    double lack = 0;  // of air below the cut-out pressure
    bool low = false;
    for (int i = 0; i < kCircuits; ++i) {
      lack += volume_[i] * std::max(0.0, cut_out_ - s->pressure[i]);
      low = low || s->pressure[i] < cut_in_;
    }
    if (low) s->pumping = 1;
    if (s->pumping == 0) return;
    double delivered = kAtmosphere * displacement_ * std::max(0.0, engine_speed) * h;
    // Each reservoir takes air in proportion to what it lacks: all are full at one time.
    double share = delivered >= lack ? 1 : delivered / lack;
    for (int i = 0; i < kCircuits; ++i) {
      s->pressure[i] += share * std::max(0.0, cut_out_ - s->pressure[i]);
    }
    if (share == 1) s->pumping = 0;
  }

  // Share of the spring brakes that is on because the air that holds them off is gone. Those of the
  // towing vehicle live on the better of its circuits, those of the trailer on its own.
  double Springs(int circuit, const ReservoirState& s) const {
    double pressure = circuit == kTrailer ? s.pressure[circuit]
                                          : *std::max_element(s.pressure, s.pressure + kTrailer);
    double share = (spring_begin_ - pressure) / (spring_begin_ - spring_full_);
    return std::clamp(share, 0.0, 1.0);
  }

 private:
  double volume_[kCircuits];
  double displacement_, cut_in_, cut_out_, spring_begin_, spring_full_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_RESERVOIR_H_
