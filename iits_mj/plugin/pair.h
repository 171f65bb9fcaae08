// Two numbers that go through the same arithmetic at once, such as those of two wheels.
//
// A wheel's forces are one long chain of operations, each of which waits for the one before; two
// wheels side by side cost hardly more than one. Every machine with 64 bits has registers for this.
#ifndef IITS_MJ_PLUGIN_PAIR_H_
#define IITS_MJ_PLUGIN_PAIR_H_

#include <cmath>

namespace iits {

// Arithmetic, comparison and `mask ? a : b` work number by number. NaN compares false.
using Pair = double __attribute__((vector_size(16)));
using PairMask = decltype(Pair{} < Pair{});

inline Pair Both(double x) { return Pair{x, x}; }
inline Pair Min(Pair a, Pair b) { return b < a ? b : a; }
inline Pair Max(Pair a, Pair b) { return a < b ? b : a; }
inline Pair Clamp(Pair a, double limit) { return Min(Max(a, Both(-limit)), Both(limit)); }
inline Pair Abs(Pair a) { return a < 0 ? -a : a; }
inline Pair Sqrt(Pair a) { return Pair{std::sqrt(a[0]), std::sqrt(a[1])}; }

// Three components each, from two places.
inline void Gather(const double* a, const double* b, int stride, Pair out[3]) {
  for (int i = 0; i < 3; ++i) out[i] = Pair{a[i * stride], b[i * stride]};
}

}  // namespace iits

#endif  // IITS_MJ_PLUGIN_PAIR_H_
