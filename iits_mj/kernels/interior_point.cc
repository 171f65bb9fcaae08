// Interior-point method of the speed planner. `controllers/pcc/problem.py` states the program, with
// its units and symbols; `controllers/pcc/interior_point.py` the method and its sources.
//
// The order of every sum is fixed here, so that the bits of a result do not depend on the
// processor. Vectors of inequalities hold, in this order: n brake forces, n rooms of the brake, n
// overruns, n full powers, n + 1 low bounds, n + 1 high bounds, n earliest times (if any applies),
// the trip time.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <vector>

#include "kernels/kernels.h"
#include "kernels/node_system.h"
#include "kernels/vectors.h"

namespace iits {
namespace {

constexpr double kInside = 0.05;     // least first slack
constexpr double kMu = 0.1;          // first s z
constexpr double kDiverged = 1e9;    // of a multiplier
constexpr double kExact = 1e-9;      // gradient of the Lagrangian that steps do not improve
constexpr double kAccepted = 100.0;  // factor on the tolerances after the last iteration
constexpr std::size_t kWindow = 30;  // iterations within which the errors must fall to a tenth
constexpr double kPinned = 1e-9;     // difference of the bounds of b below which b is fixed

// The reasons of `_NOTES` in `controllers/pcc/interior_point.py`, in its order.
enum Note { kConverged, kNotFinite, kNoDrive, kLate, kNoStep, kNoConvergence };

struct Problem {
  std::size_t n;
  double inertia, air, fuel[3], calm, worth, overrun, full, brake, time_max;
  const double *low, *high, *resistance, *earliest;

  double First() const { return 0.5 * air - inertia; }
  double Last() const { return 0.5 * air + inertia; }
  double Net(const Vector& b, std::size_t k) const {
    return First() * b[k] + Last() * b[k + 1] + resistance[k];
  }
};

struct Settings {
  double tolerance, iterations, time_limit;
};

// Drive at b and y: pace 1 / v, durations d with derivatives by b at both ends, mean speed 1 / d,
// force, pull (power over full power), times at nodes 1..n, changes of b.
struct Point {
  Vector b, y, v, pace, d, mean, d0, d1, force, pull, time, change;

  explicit Point(std::size_t n) {
    for (Vector* of_node : {&b, &v, &pace}) of_node->resize(n + 1);
    for (Vector* vector : {&y, &d, &mean, &d0, &d1, &force, &pull, &time, &change}) {
      vector->resize(n);
    }
  }

  void Evaluate(const Problem& p) {
    for (std::size_t k = 0; k <= p.n; ++k) v[k] = std::sqrt(b[k]);
    for (std::size_t k = 0; k <= p.n; ++k) pace[k] = 1.0 / v[k];
    for (std::size_t k = 0; k < p.n; ++k) {
      mean[k] = 0.5 * (v[k] + v[k + 1]);
      d[k] = 1.0 / mean[k];
      const double square = -0.25 * (d[k] * d[k]);
      d0[k] = square * pace[k];
      d1[k] = square * pace[k + 1];
      force[k] = p.Net(b, k) + y[k];
      pull[k] = force[k] * mean[k];
      change[k] = b[k + 1] - b[k];
    }
    double now = 0.0;
    for (std::size_t k = 0; k < p.n; ++k) time[k] = now += d[k];
  }

  double Cost(const Problem& p) const {
    double sum = 0.0;
    for (std::size_t k = 0; k < p.n; ++k) {
      sum += (p.fuel[0] + p.fuel[1] * pull[k] + p.fuel[2] * (pull[k] * pull[k]) +
              p.calm * (change[k] * change[k])) *
             d[k];
    }
    return sum - p.worth * b[p.n];
  }
};

struct Step {
  Vector s, z, b, y;
  Step(std::size_t m, std::size_t n) : s(m), z(m), b(n + 1), y(n) {}
};

// One run: the iterate `at`, slacks s and multipliers z.
class Run {
 public:
  Run(const Problem& problem, const Settings& settings, const double* guess)
      : p_(problem),
        settings_(settings),
        n_(p_.n),
        behind_(std::any_of(p_.earliest, p_.earliest + n_, [](double t) { return t > 0.0; })),
        m_(6 * n_ + 3 + (behind_ ? n_ : 0)),
        at_(n_),
        trial_(n_),
        present_(m_, 1.0),
        slope_b_(n_ + 1),
        pinned_(n_ + 1),
        step_(m_, n_),
        other_(m_, n_),
        system_(n_, behind_) {
    for (Vector* of_limit :
         {&s_, &z_, &residual_, &goal_, &aim_, &values_, &inverse_s_, &inverse_z_, &ratio_}) {
      of_limit->resize(m_);
    }
    for (Vector* of_interval :
         {&by_force_, &by_duration_, &by_change_, &price_, &slope_y_, &inverse_, &u0_, &u1_}) {
      of_interval->resize(n_);
    }
    MarkPresent();
    for (std::size_t k = 0; k <= n_; ++k) {
      const double edge = std::min(kInside, 0.1 * (p_.high[k] - p_.low[k]));
      at_.b[k] = std::min(std::max(guess[k], p_.low[k] + edge), p_.high[k] - edge);
    }
    for (std::size_t k = 0; k < n_; ++k) {
      const double duration = 2.0 / (std::sqrt(at_.b[k]) + std::sqrt(at_.b[k + 1]));
      const double y = std::max(0.0, -p_.overrun * duration - p_.Net(at_.b, k)) + kInside;
      at_.y[k] = std::min(y, 0.5 * (p_.brake + y));
    }
    at_.Evaluate(p_);
    Values(at_, &values_);
    for (std::size_t i = 0; i < m_; ++i) {
      // The bounds of b hold exactly at all times, so that roots are real.
      const bool node = i >= 4 * n_ && i < 6 * n_ + 2;
      s_[i] = present_[i] == 0.0 ? 1.0 : node ? values_[i] : std::max(values_[i], kInside);
      z_[i] = present_[i] * kMu / s_[i];
    }
  }

  int iterations = 0;

  // Iterates until the optimality conditions hold or cannot be reached.
  template <typename Late>
  Note Go(bool guarded, int begin, const Late& late) {
    iterations = begin;
    const double tolerance = settings_.tolerance, dual_tolerance = 100.0 * tolerance;
    // Newton's last steps make the multipliers exact, if rounding permits it.
    int polish = tolerance <= 1e-8 ? 2 : 0;
    double mu = kMu, penalty = 1.0, dual = 0.0, primal = 0.0, gap = 0.0;
    Vector errors;
    for (int i = 0; i < settings_.iterations; ++i) {
      Values(at_, &values_);
      for (std::size_t k = 0; k < m_; ++k) residual_[k] = (values_[k] - s_[k]) * present_[k];
      Gradient(z_);
      // A change of b moves the force by `Last()` times as much.
      const double by_b = Greatest(slope_b_) / p_.Last(), by_y = Greatest(slope_y_);
      dual = std::max(by_b, by_y);
      primal = Greatest(residual_);
      gap = Dot(s_, z_) / count_;
      if (!std::isfinite(by_b + by_y + primal + gap)) return kNotFinite;
      if (primal > tolerance && Greatest(z_) > kDiverged) return kNoDrive;
      if (std::max(primal, gap) < tolerance && dual < dual_tolerance) {
        if (--polish < 0 || dual < kExact) return kConverged;
      }
      if (late()) return kLate;
      if (guarded) {
        mu = Lower(mu, std::max(primal, dual));
        if (!GuardedStep(mu, &penalty)) return kNoStep;
      } else if (errors.size() > 2 * kWindow && !Falls(errors)) {
        break;
      } else if (!QuickStep(gap)) {
        return kNoStep;
      }
      errors.push_back(std::max(primal, gap));
      ++iterations;
    }
    const bool accepted =
        std::max(primal, gap) < kAccepted * tolerance && dual < kAccepted * dual_tolerance;
    return accepted ? kConverged : kNoConvergence;
  }

  // Writes b (n + 1), y (n), prices (n), costate (n + 1), the time's price and the iterations.
  void Write(double* result) {
    Slopes(z_);
    double* next = std::copy(at_.b.begin(), at_.b.end(), result);
    next = std::copy(at_.y.begin(), at_.y.end(), next);
    next = std::copy(price_.begin(), price_.end(), next);
    for (std::size_t k = 0; k < n_; ++k) *next++ = -AtStart(k);
    *next++ = AtEnd(n_ - 1);
    *next++ = z_.back();
    *next++ = iterations;
  }

 private:
  static bool Falls(const Vector& errors) {
    const auto recent = errors.end() - kWindow;
    const double least = *std::min_element(recent, errors.end());
    return least <= 0.1 * *std::min_element(errors.begin(), recent);
  }

  // Inequalities that do not apply have no multiplier.
  void MarkPresent() {
    for (std::size_t k = 0; k <= n_; ++k) {
      pinned_[k] = p_.high[k] - p_.low[k] < kPinned;
      if (pinned_[k]) present_[4 * n_ + k] = present_[5 * n_ + 1 + k] = 0.0;
    }
    for (std::size_t k = 0; behind_ && k < n_; ++k) {
      present_[6 * n_ + 2 + k] = p_.earliest[k] > 0.0 ? 1.0 : 0.0;
    }
    present_.back() = std::isfinite(p_.time_max) ? 1.0 : 0.0;
    for (double there : present_) count_ += there;
  }

  // All g(x); 1 in place of a trip time that does not apply.
  void Values(const Point& at, Vector* g) const {
    double* value = g->data();
    for (std::size_t k = 0; k < n_; ++k) {
      value[k] = at.y[k];
      value[n_ + k] = p_.brake - at.y[k];
      value[2 * n_ + k] = at.force[k] + p_.overrun * at.d[k];
      value[3 * n_ + k] = p_.full * at.d[k] - at.force[k];
    }
    for (std::size_t k = 0; k <= n_; ++k) {
      value[4 * n_ + k] = at.b[k] - p_.low[k];
      value[5 * n_ + 1 + k] = p_.high[k] - at.b[k];
    }
    for (std::size_t k = 0; behind_ && k < n_; ++k) {
      value[6 * n_ + 2 + k] = at.time[k] - p_.earliest[k];
    }
    value[m_ - 1] = present_.back() == 0.0 ? 1.0 : p_.time_max - at.time[n_ - 1];
  }

  // Derivatives of `cost - z g` by force, duration, change of b and y, and the prices of durations.
  void Slopes(const Vector& z) {
    const double *brake = z.data(), *room = brake + n_, *overrun = room + n_, *full = overrun + n_;
    double price = z.back();
    for (std::size_t k = n_; k-- > 0;) {
      // Every duration before a node helps to reach its earliest time.
      if (behind_) price -= z[6 * n_ + 2 + k];
      price_[k] = price;
    }
    for (std::size_t k = 0; k < n_; ++k) {
      const double pull = at_.pull[k], change = at_.change[k];
      by_force_[k] = p_.fuel[1] + 2.0 * p_.fuel[2] * pull - overrun[k] + full[k];
      by_duration_[k] = p_.fuel[0] - p_.fuel[2] * (pull * pull) + p_.calm * (change * change) +
                        price_[k] - (p_.overrun * overrun[k] + p_.full * full[k]);
      by_change_[k] = 2.0 * p_.calm * change * at_.d[k];
      slope_y_[k] = by_force_[k] - brake[k] + room[k];
    }
  }

  // Derivatives by b at the start and the end of an interval, from those of `Slopes`.
  double AtStart(std::size_t k) const {
    return p_.First() * by_force_[k] + at_.d0[k] * by_duration_[k] - by_change_[k];
  }
  double AtEnd(std::size_t k) const {
    return p_.Last() * by_force_[k] + at_.d1[k] * by_duration_[k] + by_change_[k];
  }

  // The gradient of `cost - z g` by b, zero where pinned, and by y.
  void Gradient(const Vector& z) {
    Slopes(z);
    const double *above = z.data() + 4 * n_, *below = above + n_ + 1;
    for (std::size_t k = 0; k <= n_; ++k) slope_b_[k] = below[k] - above[k];
    for (std::size_t k = 0; k < n_; ++k) {
      slope_b_[k] += AtStart(k);
      slope_b_[k + 1] += AtEnd(k);
    }
    slope_b_[n_] -= p_.worth;
    for (std::size_t k = 0; k <= n_; ++k) {
      if (pinned_[k]) slope_b_[k] = 0.0;
    }
  }

  // Writes the curvature by b at both ends of the intervals into the system, y eliminated.
  //
  // By y and b an interval has the squares `w_i (dy + u_i . db)^2`: of the brake's bounds (u = 0),
  // of overrun, of full power and of the fuel. Their least over dy is
  // `sum_i<j w_i w_j ((u_i - u_j) . db)^2 / sum w`, without cancellation even for large weights of
  // active bounds. `convex` omits terms that may be negative. A third try (`more`) enlarges the
  // diagonal beyond rounding errors.
  void Curvature(bool convex, double more) {
    const double first = p_.First(), last = p_.Last();
    const double *ratio = ratio_.data(), *low = ratio + 4 * n_, *high = low + n_ + 1;
    Vector& diagonal = system_.diagonal;
    for (std::size_t k = 0; k <= n_; ++k) diagonal[k] = low[k] + high[k] + 1e-12;
    for (std::size_t k = 0; k < n_; ++k) {
      const double brake = ratio[k] + ratio[n_ + k];
      const double overrun = ratio[2 * n_ + k], full = ratio[3 * n_ + k];
      const double d = at_.d[k], d0 = at_.d0[k], d1 = at_.d1[k], pull = at_.pull[k];
      const double fuel = 2.0 * p_.fuel[2] * at_.mean[k];
      const double inverse = 1.0 / (brake + overrun + full + fuel);
      // u_i = slope + x_i grad d; x: the pull of overrun, less that of full power, less its own.
      const double share0 = overrun * inverse, share1 = full * inverse, share2 = fuel * inverse;
      const double mass = share0 + share1 + share2;
      const double mean = share0 * p_.overrun - share1 * p_.full - share2 * pull;
      const double along = brake * mass, cross = brake * mean;
      const double wide = p_.overrun + p_.full, to_overrun = p_.overrun + pull;
      const double to_full = p_.full - pull;
      const double across = brake * (share0 * (p_.overrun * p_.overrun) +
                                     share1 * (p_.full * p_.full) + share2 * (pull * pull)) +
                            overrun * share1 * (wide * wide) +
                            overrun * share2 * (to_overrun * to_overrun) +
                            full * share2 * (to_full * to_full);
      double h00 = along * first * first + 2.0 * cross * first * d0 + across * d0 * d0;
      double h01 = along * first * last + cross * (first * d1 + last * d0) + across * d0 * d1;
      double h11 = along * last * last + 2.0 * cross * last * d1 + across * d1 * d1;
      // Curvature of the durations.
      const double pace0 = at_.pace[k], pace1 = at_.pace[k + 1];
      const double by = convex ? std::max(by_duration_[k], 0.0) : by_duration_[k];
      const double square = 0.125 * by * (d * d), cube = square * d;
      h00 += (cube + square * pace0) * (pace0 * pace0);
      h01 += cube * (pace0 * pace1);
      h11 += (cube + square * pace1) * (pace1 * pace1);
      const double twist = convex ? 0.0 : 2.0 * p_.calm * at_.change[k];
      const double own = 2.0 * p_.calm * d;
      h00 += own - 2.0 * twist * d0;
      h01 += twist * (d0 - d1) - own;
      h11 += own + 2.0 * twist * d1;
      inverse_[k] = inverse;
      u0_[k] = mass * first + mean * d0;
      u1_[k] = mass * last + mean * d1;
      diagonal[k] += h00;
      diagonal[k + 1] += h11;
      system_.beside[k] = pinned_[k] || pinned_[k + 1] ? 0.0 : h01;
    }
    for (std::size_t k = 0; k <= n_; ++k) diagonal[k] = pinned_[k] ? 1.0 : diagonal[k] * (1 + more);
  }

  // Factors Newton's system at the iterate, after `Gradient(z_)`: exact if it is positive definite,
  // else its convex part.
  bool Factor() {
    for (std::size_t i = 0; i < m_; ++i) {
      inverse_s_[i] = present_[i] / s_[i];
      inverse_z_[i] = 1.0 / z_[i];
      ratio_[i] = z_[i] * inverse_s_[i];
    }
    for (std::size_t k = 0; k < n_; ++k) {
      system_.d0[k] = pinned_[k] ? 0.0 : at_.d0[k];
      system_.d1[k] = pinned_[k + 1] ? 0.0 : at_.d1[k];
      system_.weights[k] = behind_ ? ratio_[6 * n_ + 2 + k] : 0.0;
    }
    system_.weights[n_ - 1] += ratio_.back();
    for (int attempt = 0; attempt < 3; ++attempt) {
      Curvature(attempt > 0, attempt > 1 ? 1e-7 : 0.0);
      if (system_.Factor()) return true;
    }
    return false;
  }

  // The step to s z = `goal_`, g = s and a stationary Lagrangian.
  void Direction(Step* step) {
    for (std::size_t i = 0; i < m_; ++i) {
      aim_[i] = (goal_[i] - z_[i] * residual_[i]) * inverse_s_[i];
    }
    Gradient(aim_);
    Vector &db = step->b, &dy = step->y;
    for (std::size_t k = 0; k <= n_; ++k) db[k] = -slope_b_[k];
    for (std::size_t k = 0; k < n_; ++k) {
      db[k] += u0_[k] * slope_y_[k];
      db[k + 1] += u1_[k] * slope_y_[k];
    }
    for (std::size_t k = 0; k <= n_; ++k) {
      if (pinned_[k]) db[k] = 0.0;
    }
    system_.Solve(&db);
    for (std::size_t k = 0; k < n_; ++k) {
      dy[k] = -slope_y_[k] * inverse_[k] - u0_[k] * db[k] - u1_[k] * db[k + 1];
    }
    Change(db, dy, &step->s);
    for (std::size_t i = 0; i < m_; ++i) {
      const double ds = step->s[i] = (step->s[i] + residual_[i]) * present_[i];
      step->z[i] = (goal_[i] - z_[i] * ds) * inverse_s_[i] - z_[i];
    }
  }

  // The first-order change of all g(x) for steps of b and y.
  void Change(const Vector& db, const Vector& dy, Vector* change) const {
    double *dg = change->data(), time = 0.0;
    for (std::size_t k = 0; k < n_; ++k) {
      const double duration = at_.d0[k] * db[k] + at_.d1[k] * db[k + 1];
      const double force = p_.First() * db[k] + p_.Last() * db[k + 1] + dy[k];
      time += duration;
      dg[k] = dy[k];
      dg[n_ + k] = -dy[k];
      dg[2 * n_ + k] = force + p_.overrun * duration;
      dg[3 * n_ + k] = p_.full * duration - force;
      if (behind_) dg[6 * n_ + 2 + k] = time;
    }
    for (std::size_t k = 0; k <= n_; ++k) {
      dg[4 * n_ + k] = db[k];
      dg[5 * n_ + 1 + k] = -db[k];
    }
    dg[m_ - 1] = -time;
  }

  // Takes a predictor and corrector step; returns false if there is no direction.
  bool QuickStep(double mu) {
    if (!Factor()) return false;
    std::fill(goal_.begin(), goal_.end(), 0.0);
    Direction(&other_);
    const double share_s = ToBoundary(inverse_s_, other_.s, 1.0);
    const double share_z = ToBoundary(inverse_z_, other_.z, 1.0);
    double sum[4] = {};
    InLanes(m_, [&](std::size_t lane, std::size_t i) {
      sum[lane] += (s_[i] + share_s * other_.s[i]) * (z_[i] + share_z * other_.z[i]);
    });
    const double ratio = ((sum[0] + sum[1]) + (sum[2] + sum[3])) / count_ / mu;
    const double target = std::max(ratio * ratio * ratio * mu, 0.1 * settings_.tolerance);
    for (std::size_t i = 0; i < m_; ++i) {
      goal_[i] = (target - other_.s[i] * other_.z[i]) * present_[i];
    }
    Direction(&step_);
    const double keep = std::max(0.99, 1.0 - mu);
    Move(ToBoundary(inverse_s_, step_.s, keep), ToBoundary(inverse_z_, step_.z, keep));
    return true;
  }

  // The next mu, lower if the problem of the last one is solved well enough.
  double Lower(double mu, double error) const {
    const double least = 0.1 * settings_.tolerance;
    while (std::max(error, OffCenter(mu)) < 10.0 * mu && mu > least) {
      mu = std::max(std::min(0.2 * mu, mu * std::sqrt(mu)), least);
    }
    return mu;
  }

  double OffCenter(double mu) const {
    double off = 0.0;
    for (std::size_t i = 0; i < m_; ++i) {
      off = std::max(off, std::fabs(s_[i] * z_[i] - mu * present_[i]));
    }
    return off;
  }

  // Takes a step that lowers the merit function, whose nu is `penalty`; false without a direction.
  bool GuardedStep(double mu, double* penalty) {
    if (!Factor()) return false;
    for (std::size_t i = 0; i < m_; ++i) goal_[i] = mu * present_[i];
    Direction(&step_);
    std::fill(aim_.begin(), aim_.end(), 0.0);
    Gradient(aim_);
    double drop = Dot(slope_b_, step_.b) + Dot(slope_y_, step_.y), missing = 0.0;
    for (std::size_t i = 0; i < m_; ++i) {
      drop -= mu * (inverse_s_[i] * step_.s[i]);
      missing += std::fabs(residual_[i]);
    }
    if (missing > 0.0) *penalty = std::max(*penalty, 2.0 * drop / missing);
    drop = std::min(drop - *penalty * missing, 0.0);
    const double start = Merit(at_, s_, mu, *penalty);
    double share = ToBoundary(inverse_s_, step_.s, 0.995);
    for (int i = 0; i < 25; ++i) {
      Add(at_.b, share, step_.b, &trial_.b);
      Add(at_.y, share, step_.y, &trial_.y);
      Add(s_, share, step_.s, &aim_);
      trial_.Evaluate(p_);
      const double merit = Merit(trial_, aim_, mu, *penalty);
      if (merit <= start + 1e-4 * share * drop + 1e-12 * std::fabs(start)) break;
      share *= 0.5;
    }
    Move(share, ToBoundary(inverse_z_, step_.z, 0.995));
    // Multipliers stay near mu / s for any step of the slacks.
    for (std::size_t i = 0; i < m_; ++i) {
      const double center = mu / s_[i];
      z_[i] = present_[i] * std::min(std::max(z_[i], 1e-10 * center), 1e10 * center);
    }
    return std::isfinite(*penalty);
  }

  double Merit(const Point& at, const Vector& s, double mu, double penalty) {
    Values(at, &values_);
    double missing = 0.0, logs = 0.0;
    for (std::size_t i = 0; i < m_; ++i) {
      missing += std::fabs((values_[i] - s[i]) * present_[i]);
      logs += present_[i] * std::log(s[i]);
    }
    return at.Cost(p_) - mu * logs + penalty * missing;
  }

  void Move(double share_s, double share_z) {
    Add(s_, share_s, step_.s, &s_);
    Add(z_, share_z, step_.z, &z_);
    Add(at_.b, share_s, step_.b, &at_.b);
    Add(at_.y, share_s, step_.y, &at_.y);
    at_.Evaluate(p_);
  }

  const Problem& p_;
  const Settings& settings_;
  std::size_t n_;
  bool behind_;    // whether any earliest time applies
  std::size_t m_;  // number of inequalities
  Point at_, trial_;
  Vector present_;    // 1 where an inequality applies, else 0
  double count_ = 0;  // of the inequalities that apply
  Vector s_, z_, residual_, goal_, aim_, values_;
  Vector inverse_s_, inverse_z_, ratio_;  // present / s, 1 / z, z / s
  Vector by_force_, by_duration_, by_change_, price_, slope_b_, slope_y_;
  Vector inverse_, u0_, u1_;  // of the intervals' squares: 1 over their sum, mean u
  std::vector<char> pinned_;  // nodes whose b is fixed
  Step step_, other_;
  NodeSystem system_;
};

}  // namespace
}  // namespace iits

// Minimizes a program of n intervals; returns the number of the reason why it ended.
//
// `input`: inertia, air, three fuel coefficients, calm, worth, overrun, full, brake, time_max,
// tolerance, iterations, time limit [s], guarded, fallback; then low, high and the guess of b, each
// (n + 1); resistance and earliest times, each (n). `result`: see `Run::Write`.
IITS_KERNEL std::ptrdiff_t iits_interior_point(std::ptrdiff_t n, const double* input,
                                               double* result) {
  using namespace iits;
  const auto began = std::chrono::steady_clock::now();
  const double* nodes = input + 16;
  const Problem problem{static_cast<std::size_t>(n),
                        input[0],
                        input[1],
                        {input[2], input[3], input[4]},
                        input[5],
                        input[6],
                        input[7],
                        input[8],
                        input[9],
                        input[10],
                        nodes,
                        nodes + n + 1,
                        nodes + 3 * (n + 1),
                        nodes + 3 * (n + 1) + n};
  const double* guess = nodes + 2 * (n + 1);
  const Settings settings{input[11], input[12], input[13]};
  const bool guarded = input[14] != 0.0, fallback = input[15] != 0.0;
  const auto late = [&] {
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - began;
    return passed.count() > settings.time_limit;
  };
  Run run(problem, settings, guess);
  Note note = run.Go(guarded, 0, late);
  if (note != kConverged && !guarded && fallback && !late()) {
    Run second(problem, settings, guess);
    note = second.Go(true, run.iterations, late);
    second.Write(result);
  } else {
    run.Write(result);
  }
  return note;
}
