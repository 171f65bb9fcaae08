// Sums and powers that round as those of Python, NumPy and OpenBLAS, on every processor.
#ifndef IITS_MJ_KERNELS_ROUNDING_H_
#define IITS_MJ_KERNELS_ROUNDING_H_

#include <cmath>
#include <cstddef>

namespace iits {

// Order of OpenBLAS's `ddot` for AVX2: sixteen partial sums, and the rest one after the other.
inline double Dot(const double* a, const double* b, std::ptrdiff_t count) {
  constexpr int kLanes = 16;
  double part[kLanes] = {};
  std::ptrdiff_t i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    for (int k = 0; k < kLanes; ++k) part[k] = std::fma(a[i + k], b[i + k], part[k]);
  }
  for (int width = kLanes / 2; width > 1; width /= 2) {
    // Sums of neighbors that are two places apart.
    for (int k = 0; k < width; ++k) part[k] = part[2 * k - k % 2] + part[2 * k - k % 2 + 2];
  }
  double sum = part[0] + part[1];
  for (; i < count; ++i) sum += a[i] * b[i];
  return sum;
}

// Order of OpenBLAS's `dgemv` for rows of three and of five numbers.
inline double Row3(const double* a, const double* b) {
  return std::fma(a[2], b[2], std::fma(a[0], b[0], a[1] * b[1]));
}

inline double Row5(const double* a, const double* b) {
  return std::fma(a[4], b[4], (a[0] * b[0] + a[2] * b[2]) + (a[1] * b[1] + a[3] * b[3]));
}

// Product of a row of a matrix with a vector; longer rows are summed one after the other.
inline double RowProduct(const double* a, const double* b, std::ptrdiff_t count) {
  return count == 3 ? Row3(a, b) : count == 5 ? Row5(a, b) : Dot(a, b, count);
}

// Order of NumPy's `add.reduce`: eight partial sums, and the rest one after the other.
inline double Sum(const double* a, std::ptrdiff_t count) {
  double sum = 0.0;
  std::ptrdiff_t i = 0;
  if (count >= 8) {
    double part[8] = {};
    for (; i + 8 <= count; i += 8) {
      for (int k = 0; k < 8; ++k) part[k] += a[i + k];
    }
    sum = ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]));
  }
  for (; i < count; ++i) sum += a[i];
  return sum;
}

// Python's `x ** 2` rounds as the C library's `pow`; the compiler would put x * x in its place.
inline double Square(double x) {
  volatile double two = 2.0;
  return std::pow(x, two);
}

}  // namespace iits

#endif  // IITS_MJ_KERNELS_ROUNDING_H_
