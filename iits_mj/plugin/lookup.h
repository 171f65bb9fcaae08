// Look-up tables of the plugins: a curve y(x) and a map z(row, column), both piecewise linear.
#ifndef IITS_MJ_PLUGIN_LOOKUP_H_
#define IITS_MJ_PLUGIN_LOOKUP_H_

#include <mujoco/mujoco.h>

#include <cstddef>
#include <vector>

namespace iits {

// Interval of strictly increasing `x` that holds `at`, and the position inside it, 0 to 1.
// Outside the table the position is held at the end: no value is ever extrapolated.
inline size_t FindInterval(const std::vector<double>& x, double at, double* fraction) {
  size_t i = 1;
  while (i + 1 < x.size() && at > x[i]) ++i;
  double f = (at - x[i - 1]) / (x[i] - x[i - 1]);
  *fraction = f < 0 ? 0 : (f > 1 ? 1 : f);
  return i - 1;
}

// y(x) through points, held constant beyond both ends.
struct Curve {
  std::vector<double> x, y;

  double operator()(double at) const {
    double f;
    size_t i = FindInterval(x, at, &f);
    return y[i] + f * (y[i + 1] - y[i]);
  }
};

// Bilinear values(row, column), held constant beyond the edges.
struct Map {
  std::vector<double> rows, columns, values;

  double operator()(double row, double column) const {
    double fr, fc;
    size_t r = FindInterval(rows, row, &fr);
    const double* low = values.data() + r * columns.size() + FindInterval(columns, column, &fc);
    const double* high = low + columns.size();
    double first = low[0] + fc * (low[1] - low[0]);
    double second = high[0] + fc * (high[1] - high[0]);
    return first + fr * (second - first);
  }
};

// A smooth y(x) sampled once on a uniform grid, so that it costs no search and no power function.
// Held constant beyond both ends; the error is at most step^2 / 8 max |y''|.
class UniformCurve {
 public:
  template <class Function>
  void Sample(const Function& f, double low, double high, int intervals) {
    low_ = low;
    inverse_step_ = intervals / (high - low);
    y_.resize(intervals + 1);
    for (int i = 0; i <= intervals; ++i) y_[i] = f(low + i / inverse_step_);
  }

  double operator()(double at) const {
    const double position = (at - low_) * inverse_step_;
    if (!(position > 0)) return y_.front();
    const size_t last = y_.size() - 1;
    if (position >= static_cast<double>(last)) return y_.back();
    const size_t i = static_cast<size_t>(position);
    return y_[i] + (position - static_cast<double>(i)) * (y_[i + 1] - y_[i]);
  }

 private:
  double low_ = 0, inverse_step_ = 0;
  std::vector<double> y_;
};

// Reads a curve from two attributes: at least two points, `x` strictly increasing.
// Returns false after an mju_warning.
bool ReadCurve(const mjModel* m, int instance, const char* x, const char* y, double low,
               double high, Curve* out);

// Reads a map from three attributes; `values` row by row.
bool ReadMap(const mjModel* m, int instance, const char* rows, const char* columns,
             const char* values, double low, double high, Map* out);

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LOOKUP_H_
