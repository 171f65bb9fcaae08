// Linear interpolation with the rounding and the ends of `numpy.interp`.
#ifndef IITS_MJ_KERNELS_INTERPOLATION_H_
#define IITS_MJ_KERNELS_INTERPOLATION_H_

#include <algorithm>
#include <cmath>

namespace iits {

// Rising abscissae. A place among them serves several rows of values.
class Abscissae {
 public:
  Abscissae(const double* x, long count) : x_(x), count_(count) {}

  // The last abscissa not above `at`, -1 before the first one; `near` is where the search begins.
  long Find(double at, long near = 0) const {
    near = std::min(std::max(near, 0L), count_ - 1);
    if (x_[near] <= at && (near + 1 == count_ || at < x_[near + 1])) return near;
    return static_cast<long>(std::upper_bound(x_, x_ + count_, at) - x_) - 1;
  }

  double Value(const double* y, double at, long found) const {
    if (std::isnan(at)) return at;
    if (found < 0) return y[0];
    if (found >= count_ - 1) return y[count_ - 1];
    if (!(x_[found] < at)) return y[found];
    const double slope = (y[found + 1] - y[found]) / (x_[found + 1] - x_[found]);
    double value = slope * (at - x_[found]) + y[found];
    if (std::isnan(value)) {  // one of the two values is infinite
      value = slope * (at - x_[found + 1]) + y[found + 1];
      if (std::isnan(value) && y[found] >= y[found + 1] && y[found] <= y[found + 1]) {
        value = y[found];
      }
    }
    return value;
  }

 private:
  const double* x_;
  long count_;
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_INTERPOLATION_H_
