// Steering along a path: linear-quadratic preview, disturbance observer, inverse of the play.
//
// `controllers/tracking/lateral.py` describes the law, its settings and its sources and has the
// same structures; `lateral_gains.py` describes the gains and packs them.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "kernels/kernels.h"
#include "kernels/rounding.h"

namespace iits {
namespace {

struct Settings {
  double period, preview_step, near_count;
  double speed_min, error_max, integral_error_max, integral_max;
  double observer_share, steady_share, trust_low, trust_high;
  double idle_angle, idle_acceleration;
  // Of the steering gear; its rate and `most`, the sine of its angle, are those of road wheels.
  double ratio, half_play, angle_max, rate_max, most;
  double missing_angle, missing_acceleration, crossing_reach;
};

struct Truck {
  double x, y, yaw, speed, lateral_speed, yaw_rate, trailer_yaw_rate, articulation;
  double steering_wheel_angle, road_wheel_angle, station;
};

struct Memory {
  double started, error, demand, integral, wheel;
  double output, flank, asked;  // Of the play.
  double predicted, expected[3], disturbance[3];
  double lasting[3];
};

// Gains at one speed; those of the curvatures ahead follow.
struct Gains {
  double speed, response, feedback[9], disturbance[3], motion[15], blame[9], balance[3];
};
constexpr std::ptrdiff_t kGains = sizeof(Gains) / sizeof(double);

constexpr double kPi = 3.141592653589793;

double Clip(double value, double low, double high) { return std::min(std::max(value, low), high); }

// Last of the rising places that is not beyond x, and not the last of all.
std::ptrdiff_t Row(const double* places, std::ptrdiff_t count, double x) {
  const std::ptrdiff_t row = std::upper_bound(places, places + count, x) - places - 1;
  return std::min(std::max<std::ptrdiff_t>(row, 0), count - 2);
}

class Path {
 public:
  // Args: `columns` are station, yaw, x, y and curvature.
  Path(const double* columns, std::ptrdiff_t points)
      : count_(points),
        station_(columns),
        yaw_(columns + points),
        x_(columns + 2 * points),
        y_(columns + 3 * points),
        last_curvature_(columns[5 * points - 1]) {
    bool jumps = false;
    for (std::ptrdiff_t i = 1; i < count_; ++i) jumps |= std::fabs(yaw_[i] - yaw_[i - 1]) >= kPi;
    if (jumps) Unwrap();
  }
  Path(const Path&) = delete;

  // Offset to the left [m] and heading error [rad].
  void Errors(const Truck& truck, double* offset, double* heading) const {
    const std::ptrdiff_t i = Row(station_, count_, truck.station);
    const double start = station_[i], end = station_[i + 1];
    // The path continues straight beyond its ends.
    const double way = truck.station - start;
    const double share = end > start ? way / (end - start) : 0.0;
    const double held = Clip(share, 0.0, 1.0);
    const double turn = yaw_[i + 1] - yaw_[i];
    const double direction = yaw_[i] + held * turn;
    const double left = truck.y - (y_[i] + share * (y_[i + 1] - y_[i]));
    const double ahead = truck.x - (x_[i] + share * (x_[i + 1] - x_[i]));
    // The points are ends of chords: the path deviates from them by the sagitta.
    const double bulge = 0.5 * turn * (end - start) * held * (1.0 - held);
    *offset = -std::sin(direction) * ahead + std::cos(direction) * left + bulge;
    const double turned = truck.yaw - direction;
    *heading = std::atan2(std::sin(turned), std::cos(turned));
  }

  // Mean curvatures [1/m] over equal steps from a station: change of heading over distance.
  void Curvatures(double from, double speed, double step, std::vector<double>* curvatures) const {
    const std::ptrdiff_t steps = curvatures->size();
    const bool beyond = from + speed * (steps * step) > station_[count_ - 1];
    std::ptrdiff_t row = -1;
    double before = 0.0, heading_before = 0.0;
    for (std::ptrdiff_t k = 0; k <= steps; ++k) {
      const double place = from + speed * (k * step);
      while (row + 1 < count_ && station_[row + 1] <= place) ++row;
      double heading = yaw_[std::max<std::ptrdiff_t>(row, 0)];
      if (row >= 0 && row < count_ - 1 && station_[row] != place) {
        const double slope = (yaw_[row + 1] - yaw_[row]) / (station_[row + 1] - station_[row]);
        heading = slope * (place - station_[row]) + yaw_[row];
      }
      // Beyond the path's end the last curvature holds.
      if (beyond) heading += last_curvature_ * std::max(place - station_[count_ - 1], 0.0);
      if (k > 0) (*curvatures)[k - 1] = (heading - heading_before) / (place - before);
      before = place, heading_before = heading;
    }
  }

 private:
  // Makes the yaw continuous, as `numpy.unwrap` does.
  void Unwrap() {
    unwrapped_.assign(yaw_, yaw_ + count_);
    double correction = 0.0;
    for (std::ptrdiff_t i = 1; i < count_; ++i) {
      const double turn = yaw_[i] - yaw_[i - 1];
      if (std::fabs(turn) >= kPi) {
        double least = std::fmod(turn + kPi, 2.0 * kPi);
        if (least < 0.0) least += 2.0 * kPi;
        least -= kPi;
        if (least == -kPi && turn > 0.0) least = kPi;
        correction += least - turn;
      }
      unwrapped_[i] += correction;
    }
    yaw_ = unwrapped_.data();
  }

  const std::ptrdiff_t count_;
  const double *station_, *yaw_, *x_, *y_;
  const double last_curvature_;
  std::vector<double> unwrapped_;
};

// Numbers between those of two speeds of the grid, the first of each row; held beyond the grid.
std::vector<double> Interpolate(const double* table, std::ptrdiff_t rows, std::ptrdiff_t width,
                                double speed) {
  std::ptrdiff_t row = 0;
  while (row < rows - 2 && table[(row + 1) * width] <= speed) ++row;
  const double *low = table + row * width, *high = low + width;
  const double share = Clip((speed - low[0]) / (high[0] - low[0]), 0.0, 1.0);
  std::vector<double> all(width);
  for (std::ptrdiff_t i = 0; i < width; ++i) all[i] = (1.0 - share) * low[i] + share * high[i];
  return all;
}

// Updates the estimate of the disturbing accelerations of (w, r, r_t).
void Observe(const Settings& s, const Gains& gains, const double (&motion)[5], Memory* m) {
  if (m->predicted) {
    double difference[3];
    for (int i = 0; i < 3; ++i) difference[i] = motion[i] - m->expected[i];
    for (int i = 0; i < 3; ++i) {
      const double seen = Row3(gains.blame + 3 * i, difference);
      m->disturbance[i] += s.observer_share * (seen - m->disturbance[i]);
    }
  }
  for (int i = 0; i < 3; ++i) m->expected[i] = Row5(gains.motion + 5 * i, motion);
  m->predicted = 1.0;
}

// Without steering there is no prediction, and the estimate decays.
void Rest(const Settings& s, Memory* m) {
  m->predicted = 0.0;
  for (double& value : m->disturbance) value *= 1.0 - s.observer_share;
}

// Follows the output of the gear, which moves only while one flank of its play is in contact.
void FollowPlay(const Settings& s, const Truck& truck, Memory* m) {
  const double wheel = truck.steering_wheel_angle;
  if (!m->started) {
    m->output = truck.road_wheel_angle * s.ratio;
    m->flank = std::copysign(1.0, wheel - m->output);
    m->asked = wheel;
  }
  m->output = Clip(m->output, wheel - s.half_play, wheel + s.half_play);
}

// Steering wheel angle [rad] that brings the gear's output to a demand of the road wheels' angle.
double TurnWheel(const Settings& s, double demand, double response, Memory* m) {
  const double missing = demand * s.ratio - m->output;
  const double bearable =
      std::min(s.missing_angle, s.missing_acceleration / std::max(response, 1e-6));
  if (missing * m->flank < -bearable * s.ratio) m->flank = -m->flank;
  // The wheel never moves off its flank toward the play.
  const double target = m->output + m->flank * (std::max(missing * m->flank, 0.0) + s.half_play);
  const double contact = m->output + m->flank * s.half_play;
  const double crossed = (contact - m->asked) * m->flank;
  m->asked = crossed > s.crossing_reach ? m->asked + m->flank * s.crossing_reach : target;
  m->asked = Clip(m->asked, -s.angle_max, s.angle_max);
  return m->asked;
}

// Advances the demanded angle, within the limits of the gear, and the integral of the offset.
void Move(const Settings& s, double rate, double error, double speed, Memory* m) {
  const double demand = m->demand + Clip(rate, -s.rate_max, s.rate_max) * s.period;
  m->demand = Clip(demand, -s.most, s.most);
  if (std::fabs(m->error) < s.integral_error_max && speed > 2.0) {
    m->integral = Clip(m->integral + error * s.period, -s.integral_max, s.integral_max);
  }
}

// Sine of the demand without corrections that are too small for a crossing of the play; `steady`
// is the sine of the angle for the path and the disturbance alone.
double Quieted(const Settings& s, double steady, double response, const Memory& m) {
  const double beyond = m.demand - steady;
  const double idle = std::min(s.idle_angle, s.idle_acceleration / response);
  const double wanted = steady + std::copysign(std::max(std::fabs(beyond) - idle, 0.0), beyond);
  return Clip(wanted, -s.most, s.most);
}

}  // namespace
}  // namespace iits

// Steering wheel angle [rad] of the next step.
//
// Args: `table` has the gains at the speeds of a grid, a row each; `columns` are those of the
// path; `course_speed` is the steer axle's speed in any direction.
IITS_KERNEL double iits_steer(const iits::Settings* settings, iits::Memory* memory,
                              const double* table, std::ptrdiff_t rows, std::ptrdiff_t previews,
                              const double* columns, std::ptrdiff_t points,
                              const iits::Truck* truck, double course_speed) {
  const iits::Settings& s = *settings;
  const iits::Truck& t = *truck;
  iits::Memory* m = memory;
  const iits::Path path(columns, points);
  double heading;
  path.Errors(t, &m->error, &heading);
  iits::FollowPlay(s, t, m);
  if (!m->started) {
    m->started = 1.0;
    m->demand = std::sin(t.road_wheel_angle);
    m->wheel = t.steering_wheel_angle;
  }
  if (t.speed < s.speed_min) {
    iits::Rest(s, m);
    return m->wheel;
  }
  const std::vector<double> numbers =
      iits::Interpolate(table, rows, iits::kGains + previews, course_speed);
  const iits::Gains& gains = *reinterpret_cast<const iits::Gains*>(numbers.data());
  const double* preview = numbers.data() + iits::kGains;
  const double angle = std::sin(t.road_wheel_angle), swing = std::sin(t.articulation);
  const double motion[] = {t.lateral_speed, t.yaw_rate, t.trailer_yaw_rate, swing, angle};
  // Without tire slip the course psi + asin(w / V) is exact in a steady turn.
  const double drift = t.lateral_speed / course_speed;
  heading += std::asin(drift) - drift;
  const double error = iits::Clip(m->error, -s.error_max, s.error_max);
  const double state[] = {motion[0], motion[1], motion[2], swing,      error,
                          heading,   angle,     m->demand, m->integral};
  std::vector<double> ahead(previews);
  path.Curvatures(t.station, course_speed, s.preview_step, &ahead);
  double rate = -iits::Dot(gains.feedback, state, 9);
  rate -= iits::Dot(preview, ahead.data(), previews);
  iits::Observe(s, gains, motion, m);
  // At walking pace the disturbance is mostly model error.
  const double trust =
      iits::Clip((course_speed - s.trust_low) / (s.trust_high - s.trust_low), 0.0, 1.0);
  double push[3];
  for (int i = 0; i < 3; ++i) push[i] = trust * m->disturbance[i];
  rate -= iits::Dot(gains.disturbance, push, 3);
  iits::Move(s, rate, error, course_speed, m);
  for (int i = 0; i < 3; ++i) m->lasting[i] += s.steady_share * (push[i] - m->lasting[i]);
  const double near = iits::Sum(ahead.data(), std::min<std::ptrdiff_t>(s.near_count, previews));
  double steady = iits::Square(course_speed) * (near / s.near_count) / gains.response;
  steady += iits::Dot(gains.balance, m->lasting, 3);
  const double demand = std::asin(iits::Quieted(s, steady, gains.response, *m));
  m->wheel = iits::TurnWheel(s, demand, gains.response, m);
  return m->wheel;
}
