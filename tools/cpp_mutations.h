// The switch of the mutants, included ahead of each mutated source: tools/mutants_cpp.py.
#ifndef IITS_MJ_TOOLS_CPP_MUTATIONS_H_
#define IITS_MJ_TOOLS_CPP_MUTATIONS_H_

#include <cstdlib>
#include <type_traits>

// Number of the mutant that is on; 0: none, -1: none, and `iits_reached` records which ones run.
__attribute__((visibility("default"))) inline int iits_mutant = [] {
  const char* number = std::getenv("IITS_MUTANT");
  return number ? std::atoi(number) : 0;
}();
__attribute__((visibility("default"))) inline unsigned char iits_reached[1 << 16] = {};

namespace mutants {

inline bool On(int number) {
  if (__builtin_expect(iits_mutant < 0, 0)) iits_reached[number] = 1;
  return __builtin_expect(iits_mutant == number, 0);
}

// `x` as the type of the expression that it replaces, which may be a pair of numbers.
template <class Type, class X>
Type As(const Type&, const X& x) {
  if constexpr (std::is_constructible_v<Type, X>) {
    return static_cast<Type>(x);
  } else {
    return Type{} + x;
  }
}

}  // namespace mutants

#endif  // IITS_MJ_TOOLS_CPP_MUTATIONS_H_
