"""The law of the tire plugin in numpy, for all wheel ends at once.

It checks the plugin and is what the plugin's speed is compared with; nothing drives with it. The
formulas are those of `iits_mj/plugin/README.md`; tabulated functions of the plugin are exact here.
Vectors have shape (3, wheels), all other quantities (wheels,).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.tire_law import nominal_cornering_coefficient

_REFERENCE_FRICTION = 0.8  # of the surface on which the parameters hold
_SLIDE_SLIP = 1.0  # theoretical slip beyond which the tread just slides
_LOW_SPEED, _LOW_SPEED_DAMPING = 2.0, 6000.0  # [m/s], [N s/m] per tire
_SPIN_WIND_UP, _SPIN_DAMPING = 0.01, 0.08  # [rad], [s]
_TURN_BEGIN, _TURN_END = 3.0, 9.0  # normalized slip
_RELAXATION_MIN = 0.1  # [m]
_SPEED_MIN = 0.5  # [m/s]
_FLAT_DROP, _FLAT_SOFT, _FLAT_DRAG = 0.1, 0.7, 9.0  # of a flat single tire
_CARRY = 0.9


@dataclass(frozen=True)
class Motion:
    """Motion of the wheel ends in world axes.

    Attributes:
      height: of the wheels' centers [m].
      arm: from the point about which moments are taken to the wheels' centers [m].
      axle: unit vectors along the spin axes.
      velocity, angular: of the hubs, at that point [m/s], [rad/s].
      spin: [rad/s]; inertia: of the spin [kg m2].
    """

    height: FloatArray
    arm: FloatArray
    axle: FloatArray
    velocity: FloatArray
    angular: FloatArray
    spin: FloatArray
    inertia: FloatArray


@dataclass(frozen=True)
class Surface:
    """The road below the wheels: height [m], unit normals, friction."""

    height: FloatArray
    normal: FloatArray
    friction: FloatArray


@dataclass(frozen=True)
class Forces:
    """Result of a step.

    Attributes:
      force, moment: on the wheel ends [N], [N m].
      bristles: at the end of the step: two deflections [m] and a wind-up [rad].
      local: forces along, to the left, upward [N].
      slip: longitudinal slip, slip angle [rad]; shape (2, wheels).
    """

    force: FloatArray
    moment: FloatArray
    bristles: FloatArray
    local: FloatArray
    slip: FloatArray


@dataclass(frozen=True)
class Tires:
    """Parameters of each wheel end, named as the plugin's attributes."""

    count: FloatArray
    free_radius: FloatArray
    rolling_radius: FloatArray
    vertical_stiffness: FloatArray
    vertical_damping: FloatArray
    cornering_coefficient: FloatArray
    pneumatic_trail: FloatArray
    nominal_load: FloatArray
    friction_lateral: FloatArray
    friction_longitudinal: FloatArray
    friction_load_slope: FloatArray
    shape_lateral: FloatArray
    shape_longitudinal: FloatArray
    curvature_lateral: FloatArray
    curvature_longitudinal: FloatArray
    load_saturation: FloatArray
    slip_stiffness: FloatArray
    relaxation_lateral: FloatArray
    relaxation_load_exponent: FloatArray
    relaxation_longitudinal: FloatArray
    rolling_resistance: FloatArray

    @classmethod
    def of(cls, parameters: TruckParameters) -> Tires:
        """Returns the wheel ends of a truck: left and right of each axle, from the front."""
        common, rows = parameters.tire_common, []
        for axle in parameters.axles:
            tire = parameters.tires[axle.tire]
            row = {**vars(tire), **vars(common)}
            row["cornering_coefficient"] = nominal_cornering_coefficient(tire, common)
            rows += [row, row]
        names = [field.name for field in fields(cls)]
        return cls(**{name: np.array([float(row[name]) for row in rows]) for name in names})

    def step(
        self,
        motion: Motion,
        surface: Surface,
        bristles: FloatArray,
        timestep: float,
        lost: FloatArray,
    ) -> Forces:
        """Returns the forces of one step, and the bristles at its end.

        Args:
          motion: of the wheels at the start of the step.
          surface: below them.
          bristles: at the start of the step; see `Forces`.
          timestep: [s].
          lost: lost share of a tire's pressure, 0 to 1.
        """
        h, spin, normal = timestep, motion.spin, surface.normal
        # Of a twin, one tire goes flat and the other carries; a single tire runs on its rim.
        lost = np.clip(lost, 0.0, 1.0)
        twin = (self.count > 1).astype(float)
        tires, rim = self.count - twin * lost, lost * (1.0 - twin)
        free_radius, rolling_radius = (
            radius - _FLAT_DROP * rim for radius in (self.free_radius, self.rolling_radius)
        )

        # Contact.
        hub = motion.velocity + _cross(motion.angular, motion.arm)
        distance = (motion.height - surface.height) * normal[2]
        deflection = free_radius - distance
        push = tires * (
            self.vertical_stiffness * deflection - self.vertical_damping * _dot(hub, normal)
        )
        touches = (deflection > 0.0) & (push > 1.0)
        load = np.where(touches, push, 1.0)
        ahead = _cross(motion.axle, normal)
        ahead /= np.sqrt(np.maximum(_dot(ahead, ahead), 1e-12))
        left = _cross(normal, ahead)
        nominal_deflection = self.nominal_load / self.vertical_stiffness
        radius = rolling_radius + (nominal_deflection - deflection) / 3.0
        speed = _dot(hub, ahead)
        slip_x = speed - radius * spin
        slip_y = _dot(hub, left) + distance * _dot(motion.angular, ahead)

        # Velocities are half a step older than positions.
        slip_y = slip_y + 0.5 * h * _dot(motion.angular, normal) * speed

        # Relaxation by the trapezoidal rule.
        transport = np.abs(radius * spin)
        relative = load / (self.count * self.nominal_load) * (self.count / tires)
        carry = _CARRY * motion.inertia / (self.slip_stiffness * self.rolling_radius**2)
        inverse_x = np.minimum(carry / (h * h * load), 1.0 / self.relaxation_longitudinal)
        length_y = self.relaxation_lateral * relative**self.relaxation_load_exponent
        inverse_y = np.minimum(1.0 / length_y, 1.0 / _RELAXATION_MIN)
        zx = _relaxed(bristles[0], h * slip_x, h * transport * inverse_x)
        zy = _relaxed(bristles[1], h * slip_y, h * transport * inverse_y)
        sx, sy = zx * inverse_x, zy * inverse_y
        square = sx * sx + sy * sy
        slides = square > _SLIDE_SLIP**2
        if slides.any():
            sliding = np.hypot(slip_x, slip_y)
            moves = sliding > 1e-6
            cut = _SLIDE_SLIP / np.where(moves, sliding, np.sqrt(square))
            sx = np.where(slides, cut * np.where(moves, -slip_x, sx), sx)
            sy = np.where(slides, cut * np.where(moves, -slip_y, sy), sy)
            zx, zy = sx / inverse_x, sy / inverse_y

        # Combined slip.
        fade = np.maximum(1.0 - self.friction_load_slope * (relative - 1.0), 0.3)
        friction = fade * surface.friction / _REFERENCE_FRICTION
        saturation = relative / self.load_saturation
        stiffness = self.cornering_coefficient * (1.0 + 1.0 / self.load_saturation**2)
        cornering = (1.0 - _FLAT_SOFT * rim) * stiffness / (1.0 + saturation**2)
        linear_x, linear_y = self.slip_stiffness * sx, cornering * sy
        friction_x = friction * self.friction_longitudinal
        friction_y = friction * self.friction_lateral
        rho = np.hypot(linear_x / friction_x, linear_y / friction_y)
        share_x = _magic_share(rho, self.shape_longitudinal, self.curvature_longitudinal)
        share_y = _magic_share(rho, self.shape_lateral, self.curvature_lateral)
        pull_x, pull_y = load * linear_x * share_x, load * linear_y * share_y
        if (rho > _TURN_BEGIN).any():
            turned = np.clip((rho - _TURN_BEGIN) / (_TURN_END - _TURN_BEGIN), 0.0, 1.0)
            limit = load * rho / np.maximum(np.hypot(sx, sy), 1e-12)
            pull_x = pull_x + turned * (limit * friction_x * share_x * sx - pull_x)
            pull_y = pull_y + turned * (limit * friction_y * share_y * sy - pull_y)

        # Damping at standstill, aligning moment, rolling resistance.
        slide = np.minimum(rho / 3.0, 1.0)
        stick = 1.0 - slide
        damping = self.count * _LOW_SPEED_DAMPING * np.maximum(1.0 - transport / _LOW_SPEED, 0.0)
        damping *= stick * np.minimum(relative, 1.0)
        fx, fy = pull_x - damping * slip_x, pull_y - damping * slip_y
        trail = self.pneumatic_trail * stick**3 / (stick + slide * slide / 3.0)
        mz = -trail * pull_y
        resistance = (1.0 + _FLAT_DRAG * rim) * self.rolling_resistance * load * radius
        wind_up = np.clip(bristles[2] + h * spin, -_SPIN_WIND_UP, _SPIN_WIND_UP)
        strained = np.clip((wind_up + _SPIN_DAMPING * spin) / _SPIN_WIND_UP, -1.0, 1.0)
        mx = (distance + 1.0 / (cornering * inverse_y)) * fy
        my = -resistance * strained - radius * fx

        reported = np.maximum(np.abs(speed), _SPEED_MIN)
        force = fx * ahead + fy * left + load * normal
        moment = _cross(motion.arm, force) + mx * ahead + my * left + mz * normal
        return Forces(
            force=force * touches,
            moment=moment * touches,
            bristles=np.stack([zx, zy, wind_up]) * touches,
            local=np.stack([fx, fy, load]) * touches,
            slip=np.stack([-slip_x / reported, np.arctan(-slip_y / reported)]) * touches,
        )


def _relaxed(deflection: FloatArray, slid: FloatArray, carried: FloatArray) -> FloatArray:
    """Deflection after a step [m], in which the patch slid [m] and this share of it rolled out."""
    explicit = np.minimum(0.5 * carried, 1.0)
    return np.asarray((deflection * (1.0 - explicit) - slid) / (1.0 + carried - explicit))


def _magic_share(rho: FloatArray, shape: FloatArray, curvature: FloatArray) -> FloatArray:
    """Magic Formula with unit initial slope and unit peak, over its argument."""
    b = rho / shape
    force = np.sin(shape * np.arctan(b - curvature * (b - np.arctan(b))))
    return np.asarray(np.divide(force, rho, out=np.ones_like(rho), where=rho > 0.0))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    # Four times faster than np.cross for a dozen vectors.
    return np.stack(
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    )
