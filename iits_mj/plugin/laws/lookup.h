// Functions given by tables: curves y(x) and maps z(row, column). `R` is the type of the table's
// numbers.
#ifndef IITS_MJ_PLUGIN_LAWS_LOOKUP_H_
#define IITS_MJ_PLUGIN_LAWS_LOOKUP_H_

#include <cstddef>
#include <vector>

#include "plugin/laws/number.h"

namespace iits {

// Interval of strictly increasing `x` that contains `at`, or else the nearest one, and the position
// in it: 0 to 1 inside, and beyond that outside of `x`.
template <class R, class T>
size_t FindIntervalBeyond(const std::vector<R>& x, T at, T* fraction) {
  size_t i = 1;
  while (i + 1 < x.size() && at > x[i]) ++i;
  *fraction = (at - x[i - 1]) / (x[i] - x[i - 1]);
  return i - 1;
}

// The same with a position from 0 to 1.
template <class R, class T>
size_t FindInterval(const std::vector<R>& x, T at, T* fraction) {
  const size_t i = FindIntervalBeyond(x, at, fraction);
  *fraction = Clamp(*fraction, 0, 1);
  return i;
}

// Piecewise linear y(x), constant beyond its ends.
template <class R>
struct Curve {
  std::vector<R> x, y;

  template <class T>
  T operator()(T at) const {
    T f;
    const size_t i = FindInterval(x, at, &f);
    return y[i] + f * (y[i + 1] - y[i]);
  }
};

// Bilinear values(row, column), stored row by row; constant beyond its edges.
template <class R>
struct Map {
  std::vector<R> rows, columns, values;

  template <class T>
  T operator()(T row, T column) const {
    T fr, fc;
    const size_t r = FindInterval(rows, row, &fr), c = FindInterval(columns, column, &fc);
    return Bilinear(r, c, fr, fc);
  }

  // The same with straight lines beyond the edges.
  template <class T>
  T Extrapolated(T row, T column) const {
    T fr, fc;
    const size_t r = FindIntervalBeyond(rows, row, &fr);
    const size_t c = FindIntervalBeyond(columns, column, &fc);
    return Bilinear(r, c, fr, fc);
  }

 private:
  template <class T>
  T Bilinear(size_t r, size_t c, T fr, T fc) const {
    const R* low = values.data() + r * columns.size() + c;
    const R* high = low + columns.size();
    const T first = low[0] + fc * (low[1] - low[0]);
    const T second = high[0] + fc * (high[1] - high[0]);
    return first + fr * (second - first);
  }
};

// A smooth y(x) sampled once on a uniform grid, evaluated without a search or power function.
// Piecewise linear; the error is at most step^2 / 8 max |y''|.
template <class R>
class UniformCurve {
 public:
  template <class Function>
  void Sample(const Function& f, R low, R high, int intervals) {
    low_ = low;
    inverse_step_ = intervals / (high - low);
    y_.resize(intervals + 1);
    for (int i = 0; i <= intervals; ++i) y_[i] = f(low + i / inverse_step_);
  }

  template <class T>
  T operator()(T at) const {
    const T position = (at - low_) * inverse_step_;
    if (!(position > 0)) return y_.front();
    const size_t last = y_.size() - 1;
    if (position >= static_cast<double>(last)) return y_.back();
    const int i = static_cast<int>(position);
    return y_[i] + (position - static_cast<double>(i)) * (y_[i + 1] - y_[i]);
  }

 private:
  R low_ = 0, inverse_step_ = 0;
  std::vector<R> y_;
};

// A smooth y(x) sampled once on a uniform grid: piecewise cubic with continuous slope (Hermite).
// The error is at most h^4 / 384 max |y''''|, h the length of an interval.
template <class R>
class Sampled {
 public:
  // Samples `f`, which must also be defined one interval beyond both ends.
  template <class Function>
  void Sample(const Function& f, double low, double high, int intervals) {
    low_ = low;
    high_ = high;
    const double h = (high - low) / intervals;
    inverse_step_ = 1 / h;
    const double e = h / 64;        // for the slopes
    pieces_.resize(intervals + 1);  // one more, for an `x` that is rounded up to `high`
    for (int i = 0; i <= intervals; ++i) {
      const R x0 = low + i * h, x1 = low + (i + 1) * h;
      const R rise = f(x1) - f(x0);
      const R s0 = (f(x0 + e) - f(x0 - e)) / (2 * e) * h;
      const R s1 = (f(x1 + e) - f(x1 - e)) / (2 * e) * h;
      pieces_[i] = {{f(x0), s0, 3 * rise - 2 * s0 - s1, s0 + s1 - 2 * rise}};
    }
  }

  // False outside the grid and for NaN, where the function itself must be called.
  template <class T>
  bool Holds(T x) const {
    return All((x >= low_) & (x < high_));
  }

  // The sampled y(x), for x on the grid.
  template <class T>
  T operator()(T x) const {
    const T u = (x - low_) * inverse_step_;
    const R* c[kLanes<T>];
    const T t = u - Each<T>([&](int k) {
                  const int i = static_cast<int>(Lane(u, k));
                  c[k] = pieces_[i].c;
                  return static_cast<double>(i);
                });
    auto of = [&c](int n) { return Each<T>([&c, n](int k) { return c[k][n]; }); };
    return of(0) + t * (of(1) + t * (of(2) + t * of(3)));
  }

  // The sampled y(x), or the function `f` outside the grid.
  template <class T, class Function>
  T operator()(T x, const Function& f) const {
    return Holds(x) ? (*this)(x) : Each<T>([&f, x](int k) { return f(Lane(x, k)); });
  }

 private:
  struct Piece {
    R c[4];
  };

  double low_ = 0, high_ = 0, inverse_step_ = 0;
  std::vector<Piece> pieces_;
};

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_LOOKUP_H_
