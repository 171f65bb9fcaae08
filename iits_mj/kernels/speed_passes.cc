// Passes over the nodes of a speed plan: the speeds that brakes and full power allow
// (`controllers/pcc/vehicle.py`), and those of a schedule (`controllers/pcc/schedule.py`).
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "kernels/kernels.h"

namespace {

// Speed w at the end of an interval at full power from speed v, 0 for a stall.
//
// The power limit holds at the mean of both speeds: `a w^2 + c = work / (v + w)`, with a from
// inertia and half the drag, c from v and the slope. The left side minus the right one increases
// with w, so that Newton's method converges.
double EndSpeed(double v, double a, double c, double work) {
  if (c * (v + 1e-3) >= work) return 0.0;
  double w = v;
  for (int i = 0; i < 30; ++i) {
    const double total = v + w, share = work / total;
    const double step = (a * w * w + c - share) / (2.0 * a * w + share / total);
    // Far from the solution a step may lead below zero speed.
    w = step < 0.9 * w ? w - step : 0.1 * w;
    if (-1e-9 < step && step < 1e-9) break;
  }
  return w;
}

}  // namespace

// Lowers b = v^2 at the n + 1 nodes to those from which the brakes meet all lower ones ahead.
//
// `half` is the drag's share of an interval; `fall` the loss of b by brakes and slope, (n).
IITS_KERNEL void iits_brakeable(std::ptrdiff_t n, double half, const double* fall, double* b) {
  for (std::ptrdiff_t k = n - 1; k >= 0; --k) {
    const double met = (b[k + 1] * (1.0 + half) + fall[k]) / (1.0 - half);
    if (met < b[k]) b[k] = std::max(met, 0.0);
  }
}

// Lowers the speeds at the n + 1 nodes to those that full power reaches; after a stall they are 0.
//
// `inertia` is the inertial mass, `step` the length of an interval, `half` half the drag, `power`
// that at the wheels, `slope` the force of grade and tires, (n).
IITS_KERNEL void iits_fastest(std::ptrdiff_t n, double inertia, double step, double half,
                              double power, const double* slope, double* speed) {
  const double twice = 2.0 * step, push = inertia / twice, work = 2.0 * power;
  bool full = false;  // whether full power does not reach the speed of node k
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double v = speed[k], wanted = speed[k + 1];
    if (!full) {
      const double b = v * v, next = wanted * wanted;
      const double force = (next - b) * inertia / twice + slope[k] + half * (next + b);
      if (!(force * 0.5 * (wanted + v) > power)) continue;
    }
    const double w = EndSpeed(v, push + half, (half - push) * v * v + slope[k], work);
    full = w < wanted;
    if (!full) continue;
    speed[k + 1] = w;
    if (w <= 0.0) {
      std::fill(speed + k + 1, speed + n + 1, 0.0);
      return;
    }
  }
}

// Raises the speeds at the n + 1 nodes to those of a truck that rolls above them without braking.
//
// It drives as in `iits_fastest`; where the engine's drag, of power `drag` at the wheels, does not
// hold a speed it rolls faster, up to the speeds `top`, (n + 1), which the brakes hold.
IITS_KERNEL void iits_rolling(std::ptrdiff_t n, double inertia, double step, double half,
                              double power, double drag, const double* slope, const double* top,
                              double* speed) {
  const double push = inertia / (2.0 * step);
  for (std::ptrdiff_t k = 0; k < n; ++k) {
    const double v = speed[k], c = (half - push) * v * v + slope[k];
    const double slowest = EndSpeed(v, push + half, c, -2.0 * drag);
    const double fastest = EndSpeed(v, push + half, c, 2.0 * power);
    const double wanted = std::min(speed[k + 1], fastest);
    speed[k + 1] = std::min(std::max(wanted, slowest), std::max(top[k + 1], wanted));
    if (speed[k + 1] > 0.0) continue;
    std::fill(speed + k + 1, speed + n + 1, 0.0);
    return;
  }
}

// Greatest value of a table at `count` places from `place` on, linear between its nodes.
//
// `table` holds the n places of the nodes, rising, then their values; beyond the ends the values of
// the ends apply.
IITS_KERNEL double iits_greatest(std::ptrdiff_t n, const double* table, double place,
                                 double spacing, std::ptrdiff_t count) {
  const double* values = table + n;
  double greatest = -HUGE_VAL;
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    const double x = place + static_cast<double>(i) * spacing;
    const std::ptrdiff_t k = std::upper_bound(table, table + n, x) - table;
    double value = values[k == 0 ? 0 : n - 1];
    if (k > 0 && k < n) {
      const double slope = (values[k] - values[k - 1]) / (table[k] - table[k - 1]);
      value = slope * (x - table[k - 1]) + values[k - 1];
    }
    greatest = std::max(greatest, value);
  }
  return greatest;
}
