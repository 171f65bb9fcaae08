// Shows a test that the compiler contracts no product and sum into one rounding.
#include "kernels/kernels.h"

IITS_KERNEL double iits_multiply_add(double a, double b, double c) { return a * b + c; }
