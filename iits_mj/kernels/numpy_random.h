// Random numbers of `numpy.random.default_rng`, so that a seed means the same trip in C++.
#ifndef IITS_MJ_KERNELS_NUMPY_RANDOM_H_
#define IITS_MJ_KERNELS_NUMPY_RANDOM_H_

#include <array>
#include <cmath>
#include <cstdint>

namespace iits {

// Layers of equal area under a density that falls from 1 at zero: Marsaglia and Tsang, The ziggurat
// method for generating random variables, Journal of Statistical Software 5 (2000).
struct Ziggurat {
  static constexpr int kLayers = 256;

  // The density, its inverse, the last layer's edge, the area beyond it, and the range of the
  // integers that are drawn.
  template <typename Density, typename Inverse>
  Ziggurat(Density density, Inverse inverse, long double edge, long double tail, long double range)
      : edge(static_cast<double>(edge)) {
    long double x = edge, at = density(x);
    const long double area = x * at + tail;
    inside[0] = static_cast<std::uint64_t>(x * at / area * range);
    width[0] = static_cast<double>(area / at / range);
    height[0] = 1.0;
    for (int i = kLayers - 1; i > 0; --i) {
      width[i] = static_cast<double>(x / range);
      height[i] = static_cast<double>(at);
      const long double next = i > 1 ? inverse(area / x + at) : 0.0L;
      inside[i] = static_cast<std::uint64_t>(next / x * range);
      x = next;
      at = density(x);
    }
  }

  std::array<std::uint64_t, kLayers> inside;
  std::array<double, kLayers> width, height;
  double edge;
};

inline const Ziggurat& NormalLayers() {
  static const Ziggurat layers(
      [](long double x) { return std::exp(-0.5L * x * x); },
      [](long double y) { return std::sqrt(-2.0L * std::log(y)); }, 3.6541528853610087963519L,
      std::sqrt(0.5L * std::acos(-1.0L)) * std::erfc(3.6541528853610087963519L / std::sqrt(2.0L)),
      4503599627370496.0L);
  return layers;
}

inline const Ziggurat& ExponentialLayers() {
  static const Ziggurat layers(
      [](long double x) { return std::exp(-x); }, [](long double y) { return -std::log(y); },
      7.6971174701310497140446L, std::exp(-7.6971174701310497140446L), 9007199254740992.0L);
  return layers;
}

// The state of `numpy.random.PCG64`: O'Neill, PCG: a family of simple fast space-efficient
// statistically good algorithms for random number generation, HMC-CS-2014-0905 (2014), XSL RR.
struct Random {
  std::uint64_t state_high, state_low, increment_high, increment_low;
  std::int64_t has_half;  // whether 32 bits of the last word are left
  std::uint64_t half;

  std::uint64_t Next() {
    __extension__ typedef unsigned __int128 Wide;
    const Wide factor = (Wide{2549297995355413924u} << 64) + 4865540595714422341u;
    Wide state = (Wide{state_high} << 64) + state_low;
    state = state * factor + ((Wide{increment_high} << 64) + increment_low);
    state_high = static_cast<std::uint64_t>(state >> 64);
    state_low = static_cast<std::uint64_t>(state);
    const std::uint64_t word = state_high ^ state_low;
    const int turn = static_cast<int>(state_high >> 58);
    return word >> turn | word << (-turn & 63);
  }

  // Uniform in [0, 1).
  double Uniform() { return static_cast<double>(Next() >> 11) / 9007199254740992.0; }

  // Uniform in 0 to 3: `integers(4)`.
  int Quarter() {
    if (has_half == 0) {
      const std::uint64_t word = Next();
      half = word >> 32;
      has_half = 1;
      return static_cast<int>((word & 0xffffffffu) >> 30);
    }
    has_half = 0;
    return static_cast<int>(half >> 30);
  }

  double Normal() {
    const Ziggurat& layers = NormalLayers();
    for (;;) {
      std::uint64_t word = Next();
      const int i = static_cast<int>(word & 255);
      word >>= 8;
      const std::uint64_t place = word >> 1 & 0xfffffffffffffu;
      const double sign = word & 1 ? -1.0 : 1.0;
      const double x = static_cast<double>(place) * layers.width[i];
      if (place < layers.inside[i]) return sign * x;
      if (i == 0) {
        for (;;) {
          const double beyond = -std::log1p(-Uniform()) / layers.edge;
          const double other = -std::log1p(-Uniform());
          if (other + other <= beyond * beyond) continue;
          return place >> 8 & 1 ? -(layers.edge + beyond) : layers.edge + beyond;
        }
      }
      if (Between(layers, i) < std::exp(-0.5 * x * x)) return sign * x;
    }
  }

  double Exponential() {
    const Ziggurat& layers = ExponentialLayers();
    for (;;) {
      std::uint64_t word = Next() >> 3;
      const int i = static_cast<int>(word & 255);
      word >>= 8;
      const double x = static_cast<double>(word) * layers.width[i];
      if (word < layers.inside[i]) return x;
      if (i == 0) return layers.edge - std::log1p(-Uniform());
      if (Between(layers, i) < std::exp(-x)) return x;
    }
  }

 private:
  double Between(const Ziggurat& layers, int i) {
    return (layers.height[i - 1] - layers.height[i]) * Uniform() + layers.height[i];
  }
};

}  // namespace iits

#endif  // IITS_MJ_KERNELS_NUMPY_RANDOM_H_
