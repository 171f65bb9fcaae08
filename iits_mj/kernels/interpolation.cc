// Interpolation at one place.
#include "kernels/interpolation.h"

#include "kernels/kernels.h"

// The value of a row of a table at a place of its first row; rows have `count` numbers.
IITS_KERNEL double iits_interpolate(const double* table, long count, long row, double at) {
  const iits::Abscissae along(table, count);
  return along.Value(table + row * count, at, along.Find(at));
}
