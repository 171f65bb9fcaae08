// Dynamic program over v^2 and gear: the joint plan of speed, gear and neutral
// (`controllers/pcc/joint.py`, which describes the problem and packs the numbers).
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "kernels/kernels.h"

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kSmooth = 0.9;  // of the lowering of the bound at the next state
constexpr int kRefinements = 8;  // of the end speed between two nodes of the grid

// Numbers of the problem; `gears` counts the gears and, as the last, neutral if `neutral` is not 0.
struct Setup {
  double intervals, step, inertia, half_drag, brake, calm, states, gears, neutral;
  double speeds, speed_first, speed_step, loads, shift_time, idle_rate, short_price, lost_time;
};

// The problem's arrays: over the intervals slope force and price of a second (n), bounds of v^2 at
// the nodes (n + 1), then of each gear over speed the force of overrun, that of full load, and
// the fuel rate over speed and load, 0 in overrun to 1 at full load.
struct Arrays {
  const double *slope, *price, *low, *high, *overrun, *full, *rate;
};

class Program {
 public:
  Program(const Setup& setup, const Arrays& arrays)
      : s_(setup),
        a_(arrays),
        n_(setup.intervals),
        states_(setup.states),
        gears_(setup.gears),
        speeds_(setup.speeds),
        loads_(setup.loads) {}

  int intervals() const { return n_; }
  int states() const { return states_; }
  int gears() const { return gears_; }

  // v^2 of a state at node k.
  double State(int k, int j) const {
    const double share = static_cast<double>(j) / (states_ - 1);
    return a_.low[k] + share * (a_.high[k] - a_.low[k]);
  }

  // Value of v^2 at node k, linear between the states.
  double Value(const double* values, int k, double b) const {
    const double width = a_.high[k] - a_.low[k];
    if (width <= 0.0) return values[0];
    const double x = std::min(std::max((b - a_.low[k]) / width, 0.0), 1.0) * (states_ - 1);
    const int j = std::min(static_cast<int>(x), states_ - 2);
    return values[j] + (x - j) * (values[j + 1] - values[j]);
  }

  // Wheel force of an interval from b to c.
  double Force(int k, double b, double c) const {
    return (c - b) * s_.inertia / (2.0 * s_.step) + a_.slope[k] + s_.half_drag * (b + c);
  }

  // Cost of an interval from b to c in a gear, infinite if the gear cannot do it.
  double Cost(int k, int gear, double b, double c) const {
    const double sum = std::sqrt(b) + std::sqrt(c), time = 2.0 * s_.step / sum;
    const double force = Force(k, b, c), gain = (c - b) / (2.0 * s_.step);
    const double other = (a_.price[k] + s_.calm * gain * gain) * time;
    const Place at = Find(0.5 * sum);
    if (Neutral(gear)) {
      const double free = At(a_.overrun, gear, at);
      if (force > free + 1e-6) return kInfinity;
      return other + s_.idle_rate * time + Unbraked(free, force);
    }
    const double overrun = At(a_.overrun, gear, at), full = At(a_.full, gear, at);
    if (!(full > overrun) || force > full * (1.0 + 1e-9) + 1e-6) return kInfinity;
    if (force <= overrun) return other + Unbraked(overrun, force);
    return other + Rate(gear, at, (force - overrun) / (full - overrun)) * time;
  }

  // v^2 at the end of an interval from b in overrun (or neutral) or at full load; -1 if the gear
  // does not run. The force is that at the mean speed.
  double End(int k, int gear, double b, bool full) const {
    const double lever = 2.0 * s_.step / s_.inertia, drag = lever * s_.half_drag;
    const double* table = full && !Neutral(gear) ? a_.full : a_.overrun;
    double c = b;
    for (int i = 0; i < 4; ++i) {
      const Place at = Find(0.5 * (std::sqrt(b) + std::sqrt(c)));
      const double force = At(table, gear, at);
      if (!std::isfinite(force)) return -1.0;
      c = std::max((b * (1.0 - drag) + lever * (force - a_.slope[k])) / (1.0 + drag), 1.0);
    }
    return c;
  }

  // v^2 that the pull lost in a change into a gear costs at full load, from b to c.
  double Lost(int gear, double b, double c) const {
    if (Neutral(gear) || s_.lost_time <= 0.0) return 0.0;
    const double speed = 0.5 * (std::sqrt(b) + std::sqrt(c));
    return 2.0 / s_.inertia * At(a_.full, gear, Find(speed)) * speed * s_.lost_time;
  }

  // Least cost from v^2 = b at node k in a gear to the end, and the best v^2 at node k + 1.
  //
  // `next` has the values of node k + 1 for this gear; `refine` searches between the states too;
  // `changed`: the gear has just been engaged.
  double Best(int k, int gear, double b, const double* next, bool refine, double* end,
              bool changed = false) const {
    const double low = a_.low[k + 1], high = a_.high[k + 1];
    double slowest = End(k, gear, b, false), fastest = End(k, gear, b, true);
    if (slowest < 0.0 || fastest < 0.0) return kInfinity;
    if (changed) {
      fastest = std::max(fastest - Lost(gear, b, fastest), 1.0);
      slowest = std::min(slowest, fastest);
    }
    double best = kInfinity;
    const auto offer = [&](double c, double fine) {
      const double cost = Cost(k, gear, b, c) + fine + Value(next, k + 1, c);
      if (cost < best) best = cost, *end = c;
      return cost;
    };
    if (fastest < low) {
      // Only a drive that leaves the bounds remains; it pays for what it lacks.
      const double lack = low - fastest, sum = std::sqrt(b) + std::sqrt(std::max(fastest, 1.0));
      *end = low;
      const double time = 2.0 * s_.step / sum,
                   rate = Neutral(gear) ? s_.idle_rate : FullRate(gear, sum);
      return (a_.price[k] + rate) * time + s_.short_price * lack + Value(next, k + 1, low);
    }
    // Brakes only where the bound needs them.
    const double from = std::min(std::max(slowest, low), high), to = std::min(fastest, high);
    offer(from, 0.0);
    if (Neutral(gear) || to <= from) return best;
    // A hair below full load, so that rounding does not exceed it.
    offer(to - 1e-9 * to, 0.0);
    const double width = (high - low) / (states_ - 1);
    if (width <= 0.0) return best;
    const int first = static_cast<int>(std::ceil((from - low) / width));
    const int last = std::min(static_cast<int>((to - low) / width), states_ - 1);
    for (int j = first; j <= last; ++j) offer(low + width * j, 0.0);
    if (refine) {
      double left = std::max(*end - width, from), right = std::min(*end + width, to);
      for (int i = 0; i < kRefinements; ++i) {
        const double third = (right - left) / 3.0;
        const double one = offer(left + third, 0.0), two = offer(right - third, 0.0);
        (one < two ? right : left) += one < two ? -third : third;
      }
    }
    return best;
  }

  // Whether v^2 = c at the end of interval k is more than a gear reaches that was just engaged.
  bool NeedsPull(int k, int gear, double b, double c) const {
    if (s_.lost_time <= 0.0 || Neutral(gear)) return false;
    const double fastest = End(k, gear, b, true);
    return c > fastest - Lost(gear, b, fastest);
  }

  // Cost of a change of gear before interval k.
  double Change(int k, int from, int to) const {
    return from == to ? 0.0 : s_.shift_time * std::max(a_.price[k] + s_.idle_rate, 0.0);
  }

 private:
  struct Place {
    int row;
    double share;
  };

  // Price of v^2 that the brakes do not take, as of one below the bounds: values stay finite.
  double Unbraked(double free, double force) const {
    const double beyond = std::max(free - s_.brake - force, 0.0);
    return s_.short_price * beyond * 2.0 * s_.step / s_.inertia;
  }

  bool Neutral(int gear) const { return s_.neutral != 0.0 && gear == gears_ - 1; }

  Place Find(double speed) const {
    const double x = (speed - s_.speed_first) / s_.speed_step;
    const double within = std::min(std::max(x, 0.0), speeds_ - 1.0);
    const int row = std::min(static_cast<int>(within), speeds_ - 2);
    return {row, within - row};
  }

  double At(const double* table, int gear, Place at) const {
    const double* row = table + gear * speeds_ + at.row;
    return row[0] + at.share * (row[1] - row[0]);
  }

  double Rate(int gear, Place at, double load) const {
    const double x = std::min(std::max(load, 0.0), 1.0) * (loads_ - 1);
    const int i = std::min(static_cast<int>(x), loads_ - 2);
    const double* low = a_.rate + (gear * speeds_ + at.row) * loads_ + i;
    const double* high = low + loads_;
    const double y = x - i, slow = low[0] + y * (low[1] - low[0]);
    return slow + at.share * (high[0] + y * (high[1] - high[0]) - slow);
  }

  double FullRate(int gear, double sum) const { return Rate(gear, Find(0.5 * sum), 1.0); }

  const Setup& s_;
  const Arrays& a_;
  const int n_, states_, gears_, speeds_, loads_;
};

}  // namespace

// Computes the values of all nodes backward from those of the last one.
//
// `values` has shape (n + 1, gears, states): the least cost from a node, a gear in use before it
// and a v^2 on; the last row is given.
IITS_KERNEL void iits_joint_values(const double* setup, const double* const* arrays,
                                   double* values) {
  const Program p(*reinterpret_cast<const Setup*>(setup), *reinterpret_cast<const Arrays*>(arrays));
  const int states = p.states(), gears = p.gears(), table = gears * states;
  std::vector<double> onward(gears), changed(gears);
  for (int k = p.intervals() - 1; k >= 0; --k) {
    const double* next = values + (k + 1) * table;
    double *here = values + k * table, end = 0.0;
    for (int j = 0; j < states; ++j) {
      const double b = p.State(k, j);
      for (int g = 0; g < gears; ++g) {
        const double* then = next + g * states;
        changed[g] = onward[g] = p.Best(k, g, b, then, false, &end);
        if (onward[g] < kInfinity && p.NeedsPull(k, g, b, end)) {
          changed[g] = p.Best(k, g, b, then, false, &end, true);
        }
      }
      for (int from = 0; from < gears; ++from) {
        double best = kInfinity;
        for (int to = 0; to < gears; ++to) {
          best = std::min(best, (from == to ? onward : changed)[to] + p.Change(k, from, to));
        }
        here[from * states + j] = best;
      }
    }
  }
}

// Computes lower bounds of the values with free changes of gear, (n + 1, states); the last row is
// given.
//
// Between two states the interpolated bound may exceed the least cost onward. Both states are
// lowered by the greatest excess at `samples` places between them.
IITS_KERNEL void iits_joint_bound(const double* setup, const double* const* arrays,
                                  std::ptrdiff_t samples, double* values) {
  const Program p(*reinterpret_cast<const Setup*>(setup), *reinterpret_cast<const Arrays*>(arrays));
  const int states = p.states(), gears = p.gears();
  std::vector<double> excess(states + 1);
  for (int k = p.intervals() - 1; k >= 0; --k) {
    const double* next = values + (k + 1) * states;
    double* here = values + k * states;
    const auto least = [&](double b) {
      double best = kInfinity, end = 0.0;
      for (int g = 0; g < gears; ++g) best = std::min(best, p.Best(k, g, b, next, true, &end));
      return best;
    };
    for (int j = 0; j < states; ++j) here[j] = least(p.State(k, j));
    std::fill(excess.begin(), excess.end(), 0.0);
    const double width = p.State(k, 1) - p.State(k, 0);
    for (int j = 0; width > 0.0 && j + 1 < states; ++j) {
      for (int i = 1; i <= samples; ++i) {
        const double b = p.State(k, j) + width * static_cast<double>(i) / (samples + 1);
        excess[j + 1] = std::max(excess[j + 1], p.Value(here, k, b) - least(b));
      }
    }
    // Of both sides; and smooth over the states, so that the excess does not grow from node to
    // node.
    for (int j = 0; j < states; ++j) excess[j] = std::max(excess[j], excess[j + 1]);
    for (int j = 1; j < states; ++j) excess[j] = std::max(excess[j], kSmooth * excess[j - 1]);
    for (int j = states - 2; j >= 0; --j) excess[j] = std::max(excess[j], kSmooth * excess[j + 1]);
    for (int j = 0; j < states; ++j) here[j] -= excess[j];
  }
}

// Drives forward along the values: v^2 at the nodes from `b[0]` on, and gears of the intervals.
//
// `gear` is the one in use at the start.
IITS_KERNEL void iits_joint_drive(const double* setup, const double* const* arrays,
                                  const double* values, std::ptrdiff_t gear, double* b,
                                  double* used) {
  const Program p(*reinterpret_cast<const Setup*>(setup), *reinterpret_cast<const Arrays*>(arrays));
  const int states = p.states(), gears = p.gears(), table = gears * states;
  int now = static_cast<int>(gear);
  for (int k = 0; k < p.intervals(); ++k) {
    const double* next = values + (k + 1) * table;
    double best = kInfinity, end = b[k];
    int chosen = now;
    for (int g = 0; g < gears; ++g) {
      double c = b[k];
      const double cost =
          p.Best(k, g, b[k], next + g * states, true, &c, g != now) + p.Change(k, now, g);
      if (cost < best) best = cost, end = c, chosen = g;
    }
    b[k + 1] = end;
    used[k] = now = chosen;
  }
}
