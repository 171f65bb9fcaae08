"""Runs of the speed planner's interior-point method with dense matrices, as their reference.

The compiled method eliminates the brake forces and solves banded systems; here each Newton step
solves one dense system over all variables x = (b, y), and inequalities that do not apply are left
out. Both take the same steps.
"""

import numpy as np


class Program:
    """Cost, inequalities and their derivatives of a `controllers.pcc.problem.Problem`."""

    def __init__(self, problem):
        p, n = problem, problem.intervals
        self.p, self.n = p, n
        self.free = np.append(p.high - p.low >= 1e-9, np.ones(n, bool))
        self.times = np.append(p.earliest > 0.0, np.isfinite(p.time_max))
        bounds = np.tile(self.free[: n + 1], 2)
        self.there = np.concatenate([np.ones(4 * n, bool), bounds, self.times])
        nodes = np.eye(n + 1, 2 * n + 1)
        self.brake = np.eye(n, 2 * n + 1, n + 1)
        self.force_slope = p.slope[0] * nodes[:-1] + p.slope[1] * nodes[1:] + self.brake
        self.change_slope = nodes[1:] - nodes[:-1]
        self.nodes = nodes

    def parts(self, x):
        """Returns speeds (n + 1,), durations, forces and changes of b, each (n,)."""
        b, y, v = x[: self.n + 1], x[self.n + 1 :], np.sqrt(x[: self.n + 1])
        return v, 2.0 / (v[:-1] + v[1:]), self.p.net(b) + y, np.diff(b)

    def duration_slope(self, x):
        v, d, _, _ = self.parts(x)
        first, last = -0.25 * d**2 / v[:-1], -0.25 * d**2 / v[1:]
        return first[:, None] * self.nodes[:-1] + last[:, None] * self.nodes[1:]

    def cost(self, x):
        p, (_, d, force, change) = self.p, self.parts(x)
        rate = p.fuel[0] * d + p.fuel[1] * force + p.fuel[2] * force**2 / d
        return float((rate + p.calm * change**2 * d).sum() - p.worth * x[self.n])

    def cost_slopes(self, x):
        """Returns the derivatives by force, duration and change of b, each (n,)."""
        (c0, c1, c2), calm, (_, d, force, change) = self.p.fuel, self.p.calm, self.parts(x)
        by_duration = c0 - c2 * (force / d) ** 2 + calm * change**2
        return c1 + 2.0 * c2 * force / d, by_duration, 2.0 * calm * change * d

    def values(self, x):
        """Returns the inequalities that apply."""
        p, n, (_, d, force, _) = self.p, self.n, self.parts(x)
        b, y, time = x[: n + 1], x[n + 1 :], np.cumsum(d)
        parts = [y, p.brake - y, force + p.overrun * d, p.full * d - force, b - p.low, p.high - b]
        return np.concatenate([*parts, time - p.earliest, [p.time_max - time[-1]]])[self.there]

    def jacobian(self, x):
        p, slope, force = self.p, self.duration_slope(x), self.force_slope
        time = np.cumsum(slope, axis=0)
        rows = [self.brake, -self.brake, force + p.overrun * slope, p.full * slope - force]
        return np.vstack([*rows, self.nodes, -self.nodes, time, -time[-1:]])[self.there]

    def gradient(self, x, z):
        """Returns the gradient of `cost - z g`, 0 where b is fixed."""
        by_force, by_duration, by_change = self.cost_slopes(x)
        slope = self.force_slope.T @ by_force + self.duration_slope(x).T @ by_duration
        slope = slope + self.change_slope.T @ by_change - self.jacobian(x).T @ z
        slope[self.n] -= self.p.worth
        return slope * self.free

    def prices(self, z):
        """Returns each interval's price of duration by trip time and earliest times, (n,)."""
        times = np.zeros(self.n + 1)
        times[self.times] = z[z.size - np.count_nonzero(self.times) :]
        return times[-1] - np.cumsum(times[-2::-1])[::-1]

    def hessian(self, x, z, convex=False):
        """Returns the Hessian of `cost - z g`; the convex part omits what may be negative."""
        p, n, (v, d, force, change) = self.p, self.n, self.parts(x)
        slope = self.duration_slope(x)
        fuel = self.force_slope - (force / d)[:, None] * slope
        by = self.cost_slopes(x)[1] + self.prices(z)
        by = by - p.overrun * z[2 * n : 3 * n] - p.full * z[3 * n : 4 * n]
        twist = 2.0 * p.calm * change
        if convex:
            by, twist = np.maximum(by, 0.0), 0.0 * twist
        mixed = self.change_slope.T @ (twist[:, None] * slope)
        matrix = fuel.T @ ((2.0 * p.fuel[2] / d)[:, None] * fuel) + mixed + mixed.T
        matrix += self.change_slope.T @ ((2.0 * p.calm * d)[:, None] * self.change_slope)
        for k in range(n):
            pace, cube = 1.0 / v[k : k + 2], by[k] * d[k] ** 3 / 8.0
            square = by[k] * d[k] ** 2 / 8.0
            matrix[k : k + 2, k : k + 2] += cube * np.outer(pace, pace) + np.diag(square * pace**3)
        return matrix


def minimize(problem, guess, tolerance=1e-8, guarded=False, iterations=100):
    """Returns x, the prices of the durations and the number of iterations at the end."""
    program, p, n = Program(problem), problem, problem.intervals
    edge = np.minimum(0.05, 0.1 * (p.high - p.low))
    b = np.clip(guess, p.low + edge, p.high - edge)
    y = np.maximum(0.0, -p.overrun * 2.0 / (np.sqrt(b[:-1]) + np.sqrt(b[1:])) - p.net(b)) + 0.05
    x = np.append(b, np.minimum(y, 0.5 * (p.brake + y)))
    inside = 4 * n + 2 * np.count_nonzero(program.free[: n + 1])
    s = program.values(x)
    s[: 4 * n], s[inside:] = np.maximum(s[: 4 * n], 0.05), np.maximum(s[inside:], 0.05)
    z, mu, penalty, polish = 0.1 / s, 0.1, 1.0, 2 if tolerance <= 1e-8 else 0
    for done in range(iterations):
        residual, gap = program.values(x) - s, float(s @ z) / s.size
        slope = program.gradient(x, z)
        dual = max(abs(slope[: n + 1]).max() / p.slope[1], abs(slope[n + 1 :]).max())
        if max(abs(residual).max(), gap) < tolerance and dual < 100.0 * tolerance:
            polish -= 1
            if polish < 0 or dual < 1e-9:
                return x, program.prices(z), done
        jacobian, free = program.jacobian(x) * program.free, np.ix_(program.free, program.free)
        for convex in (False, True):
            matrix = program.hessian(x, z, convex)
            matrix += jacobian[:inside].T @ ((z / s)[:inside, None] * jacobian[:inside])
            if np.linalg.eigvalsh(matrix[free]).min() > 0.0:
                break
        matrix += jacobian[inside:].T @ ((z / s)[inside:, None] * jacobian[inside:])

        def direction(goal, x=x, s=s, z=z, residual=residual, system=(jacobian, matrix, free)):
            jacobian, matrix, free = system
            dx = np.zeros(x.size)
            aim = program.gradient(x, (goal - z * residual) / s)
            dx[program.free] = np.linalg.solve(matrix[free], -aim[program.free])
            ds = jacobian @ dx + residual
            return dx, ds, (goal - z * ds) / s - z

        if guarded:
            mu = _lower(mu, max(abs(residual).max(), dual), s * z, 0.1 * tolerance)
            dx, ds, dz = direction(mu)
            missing = abs(residual).sum()
            drop = program.gradient(x, 0.0 * z) @ dx - mu * (ds / s).sum()
            penalty = max(penalty, 2.0 * drop / missing) if missing > 0.0 else penalty
            drop = min(drop - penalty * missing, 0.0)
            start = _merit(program, x, s, mu, penalty)
            share = _share(s, ds, 0.995)
            for _ in range(25):
                merit = _merit(program, x + share * dx, s + share * ds, mu, penalty)
                if merit <= start + 1e-4 * share * drop + 1e-12 * abs(start):
                    break
                share *= 0.5
            z = z + _share(z, dz, 0.995) * dz
            x, s = x + share * dx, s + share * ds
            z = np.clip(z, 1e-10 * mu / s, 1e10 * mu / s)
            continue
        _, ds, dz = direction(0.0)
        after = (s + _share(s, ds, 1.0) * ds) @ (z + _share(z, dz, 1.0) * dz) / s.size
        target = max((after / gap) ** 3 * gap, 0.1 * tolerance)
        dx, ds, dz = direction(target - ds * dz)
        share, keep = _share(s, ds, max(0.99, 1.0 - gap)), _share(z, dz, max(0.99, 1.0 - gap))
        x, s, z = x + share * dx, s + share * ds, z + keep * dz
    return x, program.prices(z), iterations


def _lower(mu, error, products, least):
    while max(error, abs(products - mu).max()) < 10.0 * mu and mu > least:
        mu = max(min(0.2 * mu, mu * np.sqrt(mu)), least)
    return mu


def _merit(program, x, s, mu, penalty):
    missing = abs(program.values(x) - s).sum()
    return program.cost(x) - mu * np.log(s).sum() + penalty * missing


def _share(value, step, keep):
    return min(1.0, -keep / min((step / value).min(), -1e-300))
