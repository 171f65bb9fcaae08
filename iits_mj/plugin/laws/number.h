// Arithmetic of the laws, for any type of number.
//
// A law is a template over its type of number: double, `Pair`, or any type with arithmetic,
// comparisons, conversions from double and to int, and the functions below in its own namespace,
// such as a dual number for derivatives. The laws do not include MuJoCo.
#ifndef IITS_MJ_PLUGIN_LAWS_NUMBER_H_
#define IITS_MJ_PLUGIN_LAWS_NUMBER_H_

#include <cmath>
#include <limits>

namespace iits {

using std::abs;
using std::atan;
using std::cos;
using std::exp;
using std::floor;
using std::log;
using std::pow;
using std::sin;
using std::sqrt;
using std::tan;

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Two numbers with the same arithmetic, such as those of two wheels. The forces of a wheel are a
// long chain of operations, each of which waits for the previous one: two wheels cost hardly more
// than one. Every 64-bit processor has registers for a pair. Arithmetic, comparison and
// `mask ? a : b` work number by number.
using Pair = double __attribute__((vector_size(16)));
using PairMask = decltype(Pair{} < Pair{});

inline Pair abs(Pair a) { return a < 0 ? -a : a; }
inline Pair sqrt(Pair a) { return Pair{std::sqrt(a[0]), std::sqrt(a[1])}; }

// As std::min, std::max and std::clamp (a comparison with NaN is false), also of mixed types.
template <class A, class B>
auto Min(A a, B b) {
  return b < a ? b : a;
}
template <class A, class B>
auto Max(A a, B b) {
  return a < b ? b : a;
}
template <class T, class Low, class High>
auto Clamp(T x, Low low, High high) {
  return Min(Max(x, low), high);
}

// A whole number from `low` to `high` in a state, into which users may write any number; `low` for
// NaN.
template <class T>
int Whole(T x, int low, int high) {
  return x > low ? (x < high ? static_cast<int>(x) : high) : low;
}

// Lanes of a number: two of a Pair, one of any other type.
template <class T>
inline constexpr int kLanes = 1;
template <>
inline constexpr int kLanes<Pair> = 2;

template <class T>
T Lane(T x, int) {
  return x;
}
inline double Lane(Pair x, int i) { return x[i]; }

// The number whose lanes are f(0), f(1).
template <class T, class Function>
T Each(const Function& f) {
  if constexpr (kLanes<T> == 2) {
    return T{f(0), f(1)};
  } else {
    return f(0);
  }
}

template <class T>
T Fill(double x) {
  return Each<T>([x](int) { return x; });
}

// Whether a comparison holds in any lane, or in all.
inline bool Any(bool mask) { return mask; }
inline bool Any(PairMask mask) { return mask[0] | mask[1]; }
inline bool All(bool mask) { return mask; }
inline bool All(PairMask mask) { return mask[0] & mask[1]; }

// Vectors of three numbers.
template <class T>
T Dot(const T* a, const T* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class T>
void Cross(const T* a, const T* b, T* out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

// Share of the difference that a first-order lag covers in one step, 1 - exp(-h / tau), as a Pade
// form.
template <class T>
T LagShare(T h, T tau) {
  const T x = h / tau;
  return x / (1 + 0.5 * x + x * x / 12);
}

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_LAWS_NUMBER_H_
