// A smooth function of one variable, sampled once so that it costs a few multiplications.
#ifndef IITS_MJ_PLUGIN_SAMPLED_H_
#define IITS_MJ_PLUGIN_SAMPLED_H_

#include <vector>

#include "plugin/pair.h"

namespace iits {

// Piecewise cubic with continuous slope (Hermite) on a uniform grid. The error is at most
// h^4 / 384 max |f''''|, h the length of an interval.
class Sampled {
 public:
  // Samples `f`, which must be defined one interval beyond both ends as well.
  template <class Function>
  void Sample(const Function& f, double low, double high, int intervals) {
    low_ = low;
    high_ = high;
    const double h = (high - low) / intervals;
    inverse_step_ = 1 / h;
    const double e = h / 64;        // for the slopes
    pieces_.resize(intervals + 1);  // one more, for an `x` that is rounded up to `high`
    for (int i = 0; i <= intervals; ++i) {
      const double x0 = low + i * h, x1 = low + (i + 1) * h;
      const double rise = f(x1) - f(x0);
      const double s0 = (f(x0 + e) - f(x0 - e)) / (2 * e) * h;
      const double s1 = (f(x1 + e) - f(x1 - e)) / (2 * e) * h;
      pieces_[i] = {f(x0), s0, 3 * rise - 2 * s0 - s1, s0 + s1 - 2 * rise};
    }
  }

  // False outside the grid, and for NaN: then the function itself has to be asked.
  bool Holds(Pair x) const {
    const PairMask inside = (x >= low_) & (x < high_);
    return inside[0] & inside[1];
  }

  // Values at `x`, which the grid must hold.
  Pair operator()(Pair x) const {
    const Pair u = (x - low_) * inverse_step_;
    const int i = static_cast<int>(u[0]), j = static_cast<int>(u[1]);
    const Pair t = u - Pair{static_cast<double>(i), static_cast<double>(j)};
    const Piece &p = pieces_[i], &q = pieces_[j];
    const Pair c0 = {p.c0, q.c0}, c1 = {p.c1, q.c1}, c2 = {p.c2, q.c2}, c3 = {p.c3, q.c3};
    return c0 + t * (c1 + t * (c2 + t * c3));
  }

 private:
  struct Piece {
    double c0, c1, c2, c3;
  };

  double low_ = 0, high_ = 0, inverse_step_ = 0;
  std::vector<Piece> pieces_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_SAMPLED_H_
