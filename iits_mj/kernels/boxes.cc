// Distance from rectangles of the truck to those of the traffic, in the plane.
#include <algorithm>
#include <cmath>
#include <limits>

#include "kernels/kernels.h"

namespace {

// A lower bound of a distance may be off by less than this [m].
constexpr double kRounding = 1e-6;

// A rectangle that reaches `ahead` and `behind` of an origin.
struct Box {
  double x, y, cosine, sine, length, width;  // center, heading, half sizes
  double corners[4][2];

  Box(double origin_x, double origin_y, double yaw, double ahead, double behind, double wide)
      : cosine(std::cos(yaw)),
        sine(std::sin(yaw)),
        length(0.5 * (ahead + behind)),
        width(0.5 * wide) {
    const double ends[4][2] = {
        {ahead, -width}, {ahead, width}, {-behind, width}, {-behind, -width}};
    for (int k = 0; k < 4; ++k) {
      corners[k][0] = origin_x + ends[k][0] * cosine + ends[k][1] * -sine;
      corners[k][1] = origin_y + ends[k][0] * sine + ends[k][1] * cosine;
    }
    x = 0.5 * (corners[0][0] + corners[2][0]);
    y = 0.5 * (corners[0][1] + corners[2][1]);
  }

  // Greatest gap along this rectangle's axes.
  double Gap(const Box& other) const {
    const double dx = other.x - x, dy = other.y - y;
    const double along = std::abs(cosine * other.cosine + sine * other.sine);
    const double across = std::abs(cosine * other.sine - sine * other.cosine);
    return std::max(
        std::abs(cosine * dx + sine * dy) - (length + other.length * along + other.width * across),
        std::abs(cosine * dy - sine * dx) - (width + other.length * across + other.width * along));
  }

  // Least distance from the corners of another rectangle to the edges of this one.
  double ToEdges(const Box& other) const {
    double nearest = std::numeric_limits<double>::infinity();
    for (int k = 0; k < 4; ++k) {
      const double *begin = corners[k], *end = corners[(k + 1) % 4];
      const double ex = end[0] - begin[0], ey = end[1] - begin[1];
      const double square = ex * ex + ey * ey;
      for (const auto& corner : other.corners) {
        double dx = corner[0] - begin[0], dy = corner[1] - begin[1];
        const double along = std::min(std::max((dx * ex + dy * ey) / square, 0.0), 1.0);
        dx = dx - along * ex;
        dy = dy - along * ey;
        nearest = std::min(nearest, dx * dx + dy * dy);
      }
    }
    return std::sqrt(nearest);
  }
};

}  // namespace

// The least distance from a unit to a vehicle, 0 where two overlap, infinite without a vehicle.
//   units: x, y, yaw, reach ahead and behind, width of each of the `unit_count` rectangles.
//   columns: x, y, z, yaw, length and width of the vehicles, each at its place among the rows of
//     `count` numbers; lanes: of each, negative off the route.
//   x, y, horizon: center and radius of the circle in which vehicles count.
//   z, level: height of the truck; a vehicle off the route counts within this height of it.
IITS_KERNEL double iits_nearest_box(const double* units, long unit_count, const double* columns,
                                    const long* places, const long* lanes, long count, double x,
                                    double y, double horizon, double z, double level) {
  const double* column[6];
  for (int k = 0; k < 6; ++k) column[k] = columns + places[k] * count;
  double nearest = std::numeric_limits<double>::infinity();
  for (long i = 0; i < count; ++i) {
    const double dx = column[0][i] - x, dy = column[1][i] - y;
    if (!(dx * dx + dy * dy <= horizon * horizon)) continue;
    if (lanes[i] < 0 && !(std::abs(column[2][i] - z) < level)) continue;
    const double half = 0.5 * column[4][i];
    const Box other(column[0][i], column[1][i], column[3][i], half, half, column[5][i]);
    for (long k = 0; k < unit_count; ++k) {
      const double* unit = units + 6 * k;
      const Box own(unit[0], unit[1], unit[2], unit[3], unit[4], unit[5]);
      // A lower bound of the distance, by the axes of both: most pairs need no exact one.
      const double least = std::max(own.Gap(other), other.Gap(own));
      if (least <= 0.0) return 0.0;
      if (least > nearest + kRounding) continue;
      nearest = std::min(nearest, std::min(other.ToEdges(own), own.ToEdges(other)));
    }
  }
  return nearest;
}
