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
  // In calm: times and shares of `CalmConfig`.
  double strength_max, strength_kept, horizon, settled, rest_error;
  double return_time, settle_time, delay, drift_share, path_jerk, missing_share;
};

// The units' yaw rates follow, and the articulations between them.
struct Truck {
  double x, y, yaw, speed, steering_wheel_angle, road_wheel_angle, station, lateral_speed;
};

struct Memory {
  double started, error, demand, integral, wheel;
  double output, flank, asked;  // Of the play.
  double predicted;
  double strength, drift, resting;  // Of the calm.
};

// What the observer remembers of the speeds (w, r of each unit).
struct Observed {
  Observed(double* values, std::ptrdiff_t speeds)
      : expected(values), disturbance(values + speeds), lasting(values + 2 * speeds) {}

  double *expected, *disturbance, *lasting;
};

// Gains at one speed: numbers of a row of the table.
struct Gains {
  // Numbers of states: the speeds, the motion with articulations and road wheel angle, all.
  explicit Gains(std::ptrdiff_t units) : speeds(units + 1), motions(2 * units + 1) {}

  std::ptrdiff_t States() const { return motions + 4; }

  std::ptrdiff_t Width(std::ptrdiff_t previews) const {
    return 2 + States() + speeds * (2 + motions + speeds) + previews;
  }

  void Read(const double* row) {
    response = row[1];
    feedback = row + 2;
    disturbance = feedback + States();
    motion = disturbance + speeds;
    blame = motion + speeds * motions;
    balance = blame + speeds * speeds;
    preview = balance + speeds;
  }

  const std::ptrdiff_t speeds, motions;
  double response;
  const double *feedback, *disturbance, *motion, *blame, *balance, *preview;
};

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

// Updates the estimate of the disturbing accelerations of the speeds.
void Observe(const Settings& s, const Gains& gains, const double* motion, Memory* m,
             const Observed& seen) {
  const std::ptrdiff_t n = gains.speeds;
  if (m->predicted) {
    std::vector<double> difference(n);
    for (std::ptrdiff_t i = 0; i < n; ++i) difference[i] = motion[i] - seen.expected[i];
    for (std::ptrdiff_t i = 0; i < n; ++i) {
      const double now = RowProduct(gains.blame + n * i, difference.data(), n);
      seen.disturbance[i] += s.observer_share * (now - seen.disturbance[i]);
    }
  }
  for (std::ptrdiff_t i = 0; i < n; ++i) {
    seen.expected[i] = RowProduct(gains.motion + gains.motions * i, motion, gains.motions);
  }
  m->predicted = 1.0;
}

// Without steering there is no prediction, and the estimate decays.
void Rest(const Settings& s, std::ptrdiff_t speeds, Memory* m, const Observed& seen) {
  m->predicted = 0.0;
  for (std::ptrdiff_t i = 0; i < speeds; ++i) seen.disturbance[i] *= 1.0 - s.observer_share;
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
//
// Args: `share` is of the angle that may be missing before the wheel crosses the play.
double TurnWheel(const Settings& s, double demand, double response, double share, Memory* m) {
  const double missing = demand * s.ratio - m->output;
  const double bearable =
      std::min(s.missing_angle, s.missing_acceleration / std::max(response, 1e-6));
  if (missing * m->flank < -share * bearable * s.ratio) m->flank = -m->flank;
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

// Angle of the road wheels below which a correction is not worth a crossing of the play [rad].
double Idle(const Settings& s, double response) {
  return std::min(s.idle_angle, s.idle_acceleration / response);
}

// Greatest distance from the path within a time at an offset, a drift and an acceleration.
double Farthest(double offset, double drift, double acceleration, double time) {
  const double last = offset + drift * time + 0.5 * acceleration * time * time;
  double most = std::max(std::fabs(offset), std::fabs(last));
  const double turn = acceleration == 0.0 ? 0.0 : -drift / acceleration;
  if (turn > 0.0 && turn < time) most = std::max(most, std::fabs(offset + 0.5 * drift * turn));
  return most;
}

// How the wheel rests in calm.
struct Calm {
  // Args: `steady` is the sine of the angle for the path and the disturbance alone, `drift` the
  // speed across the path, `jerk` the change of the path's lateral acceleration over time.
  Calm(const Settings& s, double steady, double response, double drift, double jerk, bool trusted,
       Memory* m)
      : jerk(jerk) {
    const double strength = std::fabs(m->demand - steady) / Idle(s, response);
    m->strength = std::max(strength, m->strength * s.strength_kept);
    calm = trusted && m->strength < s.strength_max;
    beyond = response * (std::sin(m->output / s.ratio) - steady);
    m->drift += beyond * s.period + s.drift_share * (drift - m->drift);
    // The slide that is left when the wheel has crossed the play; a drift to the path is wanted.
    slide = m->drift + beyond * s.delay + m->error / s.return_time;
    quiet = calm ? 1.0 - std::min(std::fabs(jerk) / s.path_jerk, 1.0) : 1.0;
    const double wanted = -slide / s.settle_time;
    gentle = calm && (quiet >= 0.5 || wanted * jerk >= 0.0) ? wanted / response : 0.0;
    // Where the path itself turns the wheel, a correction needs no crossing of the play.
    const bool free = (m->demand - steady) * jerk > 0.0 || m->flank * jerk > 0.0;
    idle_share = free ? quiet : 1.0;
  }

  // Share of the missing angle at which the wheel crosses the play. `correction` is the sine of the
  // wanted angle beyond the steady one.
  double Crossing(const Settings& s, double correction, Memory* m) const {
    const double moved = std::fabs(slide) * s.horizon;
    const double turned = 0.5 * std::fabs(beyond) * s.horizon * s.horizon;
    const double far = std::max(Farthest(m->error, m->drift, beyond, s.horizon), moved);
    const bool bearable = m->resting ? far < s.rest_error : std::max(moved, turned) < s.settled;
    m->resting = calm && quiet > 0.5 && bearable ? 1.0 : 0.0;
    double share = 1.0;
    if (calm && quiet > 0.5 && !m->resting) {
      const bool pushing = moved >= s.settled && correction * m->flank > 0.0;
      share = pushing ? 1.0 : s.missing_share;
    }
    if (m->flank * jerk > 0.0) {
      share += s.idle_acceleration / s.missing_acceleration * (1.0 - quiet);
    }
    return share;
  }

  const double jerk;
  bool calm;
  double beyond;      // Lateral acceleration at the gear's output beyond the steady one.
  double slide;       // [m/s]
  double quiet;       // 1 where the path's curvature does not change.
  double gentle;      // Road wheel angle against the slide.
  double idle_share;  // Of the angle that is not worth a crossing.
};

// Sine of the demand: the steady one, a gentle correction that stays within the idle angle, and
// what the controller demands beyond the idle angle.
double Quieted(const Settings& s, double steady, double response, const Calm& calm,
               const Memory& m) {
  const double beyond = m.demand - steady;
  const double idle = calm.idle_share * Idle(s, response);
  const double gentle = Clip(calm.gentle, -idle, idle);
  const double wanted =
      steady + gentle + std::copysign(std::max(std::fabs(beyond) - idle, 0.0), beyond);
  return Clip(wanted, -s.most, s.most);
}

}  // namespace
}  // namespace iits

// Steering wheel angle [rad] of the next step.
//
// Args: `observed` has three values of each speed; `table` has the gains at the speeds of a grid, a
// row each; `columns` are those of the path; `course_speed` is the steer axle's speed in any
// direction.
IITS_KERNEL double iits_steer(const iits::Settings* settings, iits::Memory* memory,
                              double* observed, const double* table, std::ptrdiff_t rows,
                              std::ptrdiff_t previews, const double* columns, std::ptrdiff_t points,
                              const iits::Truck* truck, std::ptrdiff_t units, double course_speed) {
  const iits::Settings& s = *settings;
  const iits::Truck& t = *truck;
  iits::Memory* m = memory;
  iits::Gains gains(units);
  const std::ptrdiff_t speeds = gains.speeds;
  const iits::Observed seen(observed, speeds);
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
    iits::Rest(s, speeds, m, seen);
    return m->wheel;
  }
  const std::vector<double> numbers =
      iits::Interpolate(table, rows, gains.Width(previews), course_speed);
  gains.Read(numbers.data());
  const double angle = std::sin(t.road_wheel_angle);
  // Lateral speed, yaw rates and sines of the articulations, then the road wheel angle.
  const double* own = &t.lateral_speed;
  std::vector<double> motion(own, own + gains.motions - 1);
  for (std::ptrdiff_t i = speeds; i < gains.motions - 1; ++i) motion[i] = std::sin(motion[i]);
  // Without tire slip the course psi + asin(w / V) is exact in a steady turn.
  const double drift = t.lateral_speed / course_speed;
  heading += std::asin(drift) - drift;
  const double error = iits::Clip(m->error, -s.error_max, s.error_max);
  std::vector<double> state = motion;
  for (double value : {error, heading, angle, m->demand, m->integral}) state.push_back(value);
  motion.push_back(angle);
  std::vector<double> ahead(previews);
  path.Curvatures(t.station, course_speed, s.preview_step, &ahead);
  double rate = -iits::Dot(gains.feedback, state.data(), state.size());
  rate -= iits::Dot(gains.preview, ahead.data(), previews);
  iits::Observe(s, gains, motion.data(), m, seen);
  // At walking pace the disturbance is mostly model error.
  const double trust =
      iits::Clip((course_speed - s.trust_low) / (s.trust_high - s.trust_low), 0.0, 1.0);
  std::vector<double> push(seen.disturbance, seen.disturbance + speeds);
  for (double& value : push) value *= trust;
  rate -= iits::Dot(gains.disturbance, push.data(), speeds);
  iits::Move(s, rate, error, course_speed, m);
  for (std::ptrdiff_t i = 0; i < speeds; ++i) {
    seen.lasting[i] += s.steady_share * (push[i] - seen.lasting[i]);
  }
  const std::ptrdiff_t count = std::min<std::ptrdiff_t>(s.near_count, previews);
  const std::ptrdiff_t next = std::min<std::ptrdiff_t>(count, previews - count);
  const double near = iits::Sum(ahead.data(), count) / s.near_count;
  const double later = iits::Sum(ahead.data() + next, count) / s.near_count;
  const double square = iits::Square(course_speed);
  double steady = square * near / gains.response;
  steady += iits::Dot(gains.balance, seen.lasting, speeds);
  const double jerk = square * (later - near) / (s.near_count * s.preview_step);
  const double across = t.lateral_speed + course_speed * heading;
  const iits::Calm calm(s, steady, gains.response, across, jerk, trust == 1.0, m);
  const double wanted = iits::Quieted(s, steady, gains.response, calm, *m);
  const double share = calm.Crossing(s, wanted - steady, m);
  m->wheel = iits::TurnWheel(s, std::asin(wanted), gains.response, share, m);
  return m->wheel;
}
