"""Pages of trucks: contents, simulated drives, drawings of every combination."""

import math

import numpy as np
import pytest

from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.render.truck_drawings import specific_fuel
from iits_mj.render.truck_page import (
    Maneuvers,
    coast_down,
    compare_page,
    full_pedal,
    time_between,
    truck_page,
)


@pytest.mark.parametrize("name", shipped_trucks())
def test_page_of_every_shipped_truck_has_all_parts(name):
    page = truck_page(name, "1.2.3")
    html = page.to_html()
    assert page.title == name
    assert html.count("<img") == 6
    for part in ("Gear diagram", "Low-speed turns", "turning circle, wall to wall", "Provenance"):
        assert part in html
    assert not any(
        "nan" in cell.split() for section in page.sections for row in section.rows for cell in row
    )


def test_swept_width_of_a_tractor_alone_is_little_more_than_its_width():
    alone, laden = (Maneuvers.of(TruckParameters.load(n)) for n in ("vecto_tractor", "vecto_40t"))
    assert 2.5 < alone.width < 4.0 < laden.width
    assert alone.circle == laden.circle or alone.circle.wall == pytest.approx(laden.circle.wall)


def test_more_power_for_the_mass_is_faster_and_a_lighter_truck_rolls_out_sooner():
    # 350 kW for 40 t, 412 kW for 55 t
    trucks = [TruckParameters.load(name) for name in ("vecto_40t", "tractor_semitrailer_6x4")]
    starts = [time_between(full_pedal(p), 0.1, 50 * KMH) for p in trucks]
    assert 15.0 < starts[0] < starts[1] < 60.0
    trucks = [TruckParameters.load(name) for name in ("vecto_tractor", "vecto_40t")]
    rolls = [time_between(coast_down(p), 89 * KMH, 60 * KMH) for p in trucks]
    assert rolls[0] < rolls[1]


def test_time_between_speeds_that_are_not_reached_is_nan():
    run = (np.arange(4.0), np.array([0.0, 1.0, 2.0, 3.0]))
    assert time_between(run, 1.0, 3.0) == 2.0
    assert math.isnan(time_between(run, 1.0, 5.0))


def test_best_specific_fuel_of_the_maps_is_that_of_a_modern_diesel():
    for name in ("tractor_semitrailer_6x4", "vecto_40t"):
        speed, torque = np.meshgrid(np.linspace(90.0, 190.0, 20), np.linspace(500.0, 2200.0, 20))
        best = specific_fuel(TruckParameters.load(name), speed, torque).min()
        assert 175.0 < best < 195.0


def test_comparison_numbers_trucks_of_the_same_name():
    page, text = compare_page(["vecto_tractor", "vecto_tractor"], "1.2.3")
    assert "vecto_tractor (1)" in text
    assert "vecto_tractor (2)" in page.to_html()
    assert page.to_html().count("<img") == 1
    assert page.to_html().count('class="plot"') == 5
