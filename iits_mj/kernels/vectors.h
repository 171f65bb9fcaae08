// Vectors of doubles whose sums and extremes have one order of operations on every processor.
#ifndef IITS_MJ_KERNELS_VECTORS_H_
#define IITS_MJ_KERNELS_VECTORS_H_

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace iits {

using Vector = std::vector<double>;

// Calls `update` with the lane and index of each element. Results in four lanes do not wait for one
// another, and their order is the same on every processor.
template <typename Update>
void InLanes(std::size_t size, const Update& update) {
  std::size_t i = 0;
  for (; i + 4 <= size; i += 4) {
    for (std::size_t lane = 0; lane < 4; ++lane) update(lane, i + lane);
  }
  for (; i < size; ++i) update(i % 4, i);
}

// Greatest absolute value, NaN if any element is not finite.
inline double Greatest(const Vector& a) {
  double greatest[4] = {}, rest[4] = {};
  InLanes(a.size(), [&](std::size_t lane, std::size_t i) {
    const double value = std::fabs(a[i]);
    greatest[lane] = value > greatest[lane] ? value : greatest[lane];
    rest[lane] += value - value;
  });
  return std::max(std::max(greatest[0], greatest[1]), std::max(greatest[2], greatest[3])) +
         ((rest[0] + rest[1]) + (rest[2] + rest[3]));
}

inline double Dot(const Vector& a, const Vector& b) {
  double sum[4] = {};
  InLanes(a.size(), [&](std::size_t lane, std::size_t i) { sum[lane] += a[i] * b[i]; });
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

inline void Add(const Vector& a, double share, const Vector& step, Vector* sum) {
  for (std::size_t i = 0; i < a.size(); ++i) (*sum)[i] = a[i] + share * step[i];
}

// Greatest share of a step, at most 1, that leaves 1 - `keep` of every value, given 1 / value.
inline double ToBoundary(const Vector& inverse, const Vector& step, double keep) {
  double falls[4] = {};
  InLanes(step.size(), [&](std::size_t lane, std::size_t i) {
    // If an inequality does not apply, the quotient is 0 or NaN, which is not less.
    const double quotient = step[i] * inverse[i];
    falls[lane] = quotient < falls[lane] ? quotient : falls[lane];
  });
  const double fall = *std::min_element(falls, falls + 4);
  return fall < 0.0 ? std::min(1.0, -keep / fall) : 1.0;
}

}  // namespace iits

#endif  // IITS_MJ_KERNELS_VECTORS_H_
