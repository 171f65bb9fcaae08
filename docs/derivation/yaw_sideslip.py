"""Derives the yaw-sideslip model, compares it with the package and the printed equations.

    python docs/derivation/yaw_sideslip.py                          # the derivation
    python docs/derivation/yaw_sideslip.py --plot docs/images       # also the figures
    python docs/derivation/yaw_sideslip.py --page docs/analytic.md  # also the tables

Every claim is asserted: the script ends with an error if one fails.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import kinematic_model
import lagrange_model as symbols
import numpy as np
import quasi_coordinates
import sympy as sp
from lagrange_model import FORCES, STATES, STIFFNESSES, TRAILS, Matrices, derive
from printed_model import CORRECTED, PRINTED, READINGS, Reading, matrices

from iits_mj.analytic import LateralSystem, YawPlane, step_response
from iits_mj.core.arrays import FloatArray
from iits_mj.parameters import TruckParameters

ROOT = Path(__file__).resolve().parents[2]
V80 = 80.0 / 3.6
STEP = np.deg2rad(15.0)


def numbers(model: YawPlane, speed: float) -> dict[sp.Symbol, float]:
    """The model's numbers and the speed [m/s] by the paper's symbols."""
    if model.unit.tolist() != [0, 0, 0, 1, 1, 1]:
        raise ValueError("the paper's symbols want a tandem and a tri-axle")
    tandem, triaxle = model.position[1:3] - model.reference, model.position[3:]
    values = dict(zip((symbols.m_c, symbols.m_t), model.mass, strict=True))
    values |= dict(zip((symbols.I_c, symbols.I_t), model.inertia, strict=True))
    values |= dict(
        zip((symbols.t_1, symbols.t_2, symbols.t_3), model.trail[[0, 1, 3]], strict=True)
    )
    values |= {
        symbols.v: speed,
        symbols.L_c1: model.reference - model.position[0],
        symbols.L_h: model.couplings[0] - model.reference,
        symbols.L_t1: model.cg[1],
        symbols.L_c2: float(tandem.mean()),
        symbols.i_2: float(np.diff(tandem)[0]) / 2.0,
        symbols.L_t2: float(triaxle.mean() - model.cg[1]),
        symbols.i_3: float(np.diff(triaxle)[0]),
    }
    return values | dict(zip(STIFFNESSES, model.cornering, strict=True))


def numeric(
    derived: Matrices, model: YawPlane, speed: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """H (4, 4), A_h (4, 4) and B_h (4,) with the model's numbers."""
    values = numbers(model, speed)
    H, A_h, B_h = _compiled(derived, tuple(values))(*values.values())
    return H, A_h, B_h[:, 0]


@cache
def _compiled(derived: Matrices, names: tuple[sp.Symbol, ...]) -> Callable[..., list[FloatArray]]:
    return sp.lambdify(names, [derived.H, derived.A_h, derived.B_h], "numpy")


def greatest_difference(model: YawPlane, speed: float) -> float:
    """Difference of derived and package matrices, relative to each matrix's greatest element."""
    derived = numeric(derive().matrices, model, speed)
    forces, H = model.forces(speed), np.eye(4)
    H[:3, :3] = model.inertia_matrix()
    A_h = np.vstack([forces[:, :4], [0.0, 1.0, -1.0, 0.0]])
    ours = (H, A_h, np.append(forces[:, 4], 0.0))
    return max(
        float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in zip(derived, ours, strict=True)
    )


def system(reading: Reading, model: YawPlane, speed: float) -> LateralSystem:
    """State space of a reading of the printed equations, with the model's numbers."""
    H, A_h, B_h = numeric(matrices(reading), model, speed)
    return replace(model.at(speed), A=np.linalg.solve(H, A_h), B=np.linalg.solve(H, B_h))


@dataclass(frozen=True)
class Effect:
    """Behavior of a reading at one speed, in the paper's step of 15 deg at the steering wheel.

    Attributes:
      label: of the reading; payload: [kg].
      growth: greatest real part of the eigenvalues [1/s], positive if unstable.
      unstable_from: lowest speed at which it is positive [m/s], inf if there is none.
      yaw_rate: after 10 s, relative to the corrected model's.
      articulation: the same for the hitch angle.
    """

    label: str
    payload: float
    growth: float
    unstable_from: float
    yaw_rate: float
    articulation: float


def _growth(found: LateralSystem) -> float:
    return float(found.eigenvalues()[0].real)


def unstable_from(reading: Reading, model: YawPlane) -> float:
    """Lowest speed to 60 m/s at which an eigenvalue's real part is positive [m/s], to 0.1 m/s."""
    speeds = np.arange(2.0, 60.0, 0.1)
    # A zero eigenvalue means drift, not growth.
    growing = [v for v in speeds if _growth(system(reading, model, float(v))) > 1e-6]
    return float(growing[0]) if growing else float("inf")


def effects(parameters: TruckParameters, speed: float = V80) -> list[Effect]:
    """Effects of every reading, laden and empty, without pneumatic trail as in the paper."""
    rows = []
    for payload in (parameters.payload_max, 0.0):
        model = YawPlane.from_parameters(parameters, payload, pneumatic_trail=False)
        steer = STEP / parameters.steering.ratio
        right = step_response(system(CORRECTED, model, speed), steer)
        for reading in READINGS:
            found = system(reading, model, speed)
            answer = step_response(found, steer)
            rows.append(
                Effect(
                    label=reading.label,
                    payload=payload,
                    growth=_growth(found),
                    unstable_from=unstable_from(reading, model),
                    yaw_rate=float(answer.yaw_rate[-1] / right.yaw_rate[-1]),
                    articulation=float(answer.articulation[-1] / right.articulation[-1]),
                )
            )
    return rows


def effects_table(rows: list[Effect]) -> str:
    """Markdown table of the readings' effects."""
    lines = [
        "| reading | payload [t] | greatest real part [1/s] | unstable from [km/h]"
        " | yaw rate at 10 s | hitch angle at 10 s |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        verdict = "stable" if row.growth < -1e-9 else "unstable" if row.growth > 1e-9 else "drifts"
        limit = f"{3.6 * row.unstable_from:.0f}" if np.isfinite(row.unstable_from) else "none"
        lines.append(
            f"| {row.label} | {row.payload / 1e3:g} | {row.growth:+.2f}, {verdict} | {limit}"
            f" | {row.yaw_rate:.3g} | {row.articulation:.3g} |"
        )
    return "\n".join(lines)


def show(title: str, expression: sp.Basic) -> None:
    """Prints a step."""
    print(f"\n{title}\n")
    sp.pprint(expression, wrap_line=False)


def show_derivation() -> None:
    """Prints the steps and asserts the claims about the printed equations."""
    steps = derive()
    names = ("along the tractor", "across the tractor", "about beta_c", "about beta_t")
    for name, row in zip(names, steps.balance, strict=True):
        show(f"Step 3. Exact balance (inertia - force = 0) {name}:", row)
    show("Step 4. Drive force that holds the speed:", steps.drive_force)
    for name, row in zip(names[1:], steps.lateral, strict=True):
        show(f"Step 5. Linear balance {name}:", row)
    for force, slip in zip(FORCES, steps.slips, strict=True):
        show(f"Step 6. Slip angle of the axle of {force}:", slip)
    show("Step 7. H =", steps.matrices.H)
    for row, name in enumerate((*names[1:], "of gamma")):
        for state in STATES:
            show(f"A_h, {name}, by {state}:", steps.matrices.A_h[row, STATES.index(state)])
    show("B_h =", steps.matrices.B_h)

    bare = dict.fromkeys(TRAILS, 0)
    print("\nThe printed matrices minus the derived ones, without pneumatic trail:")
    for reading in READINGS:
        found = matrices(reading)
        pairs = zip(
            (found.H, found.A_h, found.B_h),
            (steps.matrices.H, steps.matrices.A_h, steps.matrices.B_h),
            strict=True,
        )
        H, A_h, B_h = ((a - b.subs(bare)).applyfunc(sp.factor) for a, b in pairs)
        assert H.is_zero_matrix, "the printed H must be right"
        assert B_h.is_zero_matrix, "the printed B_h must be right"
        assert A_h.is_zero_matrix == (reading == CORRECTED), reading.label
        show(f"A_h, {reading.label}:", A_h)

    inertia = steps.lateral.subs(dict.fromkeys(FORCES, 0))
    second = quasi_coordinates.inertia_terms(quasi_coordinates.energy())
    assert (second - inertia).expand().is_zero_matrix, "Boltzmann-Hamel must agree"
    missed = quasi_coordinates.inertia_terms(quasi_coordinates.printed_energy()) - inertia
    show("Boltzmann-Hamel agrees. With the printed T it would be wrong by:", missed.expand())

    kinematic = kinematic_model.derived() - kinematic_model.printed()
    assert kinematic.applyfunc(sp.simplify).is_zero_matrix, "the printed kinematics must be right"
    print("\nThe printed kinematic model is correct.")
    ground = kinematic_model.balance() - kinematic_model.printed_balance()
    show("Tire-ground balance: derived less printed:", ground.applyfunc(sp.factor))


def check_package(parameters: TruckParameters) -> float:
    """Greatest difference to the package over payloads, speeds and both trail settings."""
    worst = max(
        greatest_difference(
            YawPlane.from_parameters(parameters, payload, pneumatic_trail=trail), speed
        )
        for payload in (0.0, parameters.payload_max / 3.0, parameters.payload_max)
        for speed in (5.0, V80, 30.0)
        for trail in (False, True)
    )
    assert worst < 1e-12, worst
    return worst


def write_block(page: Path, name: str, text: str) -> None:
    """Replaces the text between the page's markers `<!-- name -->` and `<!-- end -->`."""
    head, found, rest = page.read_text(encoding="utf-8").partition(f"<!-- {name} -->\n")
    _, end, tail = rest.partition("<!-- end -->")
    if not (found and end):
        raise SystemExit(f"{page}: no block '<!-- {name} -->' ... '<!-- end -->'")
    page.write_text(f"{head}{found}\n{text}\n\n{end}{tail}", encoding="utf-8")


def main() -> None:
    """Prints the derivation; writes figures and the page's table on demand."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plot", type=Path, metavar="DIR", help="write the figures there")
    parser.add_argument("--page", type=Path, metavar="FILE", help="renew the page's tables")
    arguments = parser.parse_args()
    parameters = TruckParameters.load()
    show_derivation()
    worst = check_package(parameters)
    print(f"\nDerived matrices equal iits_mj.analytic.YawPlane: at most {worst:.1e} apart.")
    rows = effects(parameters)
    growth = {(row.label, row.payload): row.growth for row in rows}
    laden = parameters.payload_max
    assert growth[PRINTED.label, laden] > 0.0 > growth[CORRECTED.label, laden]
    print(f"\nAt 80 km/h, step of 15 deg at the steering wheel:\n\n{effects_table(rows)}")
    if arguments.page or arguments.plot:
        # Only these need matplotlib and the multibody model.
        import figures

        if arguments.page:
            write_block(arguments.page, "effects", effects_table(rows))
            write_block(arguments.page, "agreement", figures.agreement_table(parameters))
        if arguments.plot:
            figures.write(arguments.plot, parameters)


if __name__ == "__main__":
    main()
