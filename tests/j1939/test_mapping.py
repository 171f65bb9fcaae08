"""The table of signals against DBC, model, messages, the standard's numbers and the manual page."""

import csv

import pytest
from j1939_manual import PAGE

from iits_mj.core.messages import EgoState, TruckReport, VehicleCommand
from iits_mj.j1939 import encode, group_type, make_group, message_names, pgn_of
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.groups import layouts
from iits_mj.j1939.mapping import commands, reports, sender
from iits_mj.j1939.quantities import quantities
from iits_mj.truck import Truck

# Priority of each group and address of its sender in J1939.
STANDARD = {
    "XBR": (3, 0x2A),
    "TSC1": (3, 0x2A),
    "EEC1": (3, 0),
    "EEC2": (3, 0),
    "EEC3": (6, 0),
    "ERC1": (6, 15),
    "ETC1": (3, 3),
    "ETC2": (6, 3),
    "CCVS1": (6, 0),
    "EBC1": (6, 11),
    "EBC2": (6, 11),
    "EBC3": (6, 11),
    "EBC5": (6, 11),
    "VDC2": (6, 62),
    "LFE1": (6, 0),
    "HRLFC": (6, 0),
    "AIR1": (6, 11),
    "VW": (6, 47),
    "CVW": (7, 11),
}
# The suspect parameters of the truck's own reports and commands, as the public tables number them.
SPNS = {
    ("EEC2", "accelerator_pedal_position_percent"): 91,
    ("XBR", "external_acceleration_demand"): 2920,
    ("XBR", "xbr_control_mode"): 2916,
    ("EEC1", "engine_torque_mode"): 899,
    ("EEC1", "driver_demand_torque_percent"): 512,
    ("EEC1", "actual_engine_torque_percent"): 513,
    ("EEC1", "engine_speed_rpm"): 190,
    ("EEC2", "engine_percent_load_at_speed"): 92,
    ("EEC3", "nominal_friction_torque_percent"): 514,
    ("ETC1", "output_shaft_speed_rpm"): 191,
    ("ETC1", "input_shaft_speed_rpm"): 161,
    ("ETC1", "clutch_slip_percent"): 522,
    ("ETC1", "shift_in_process"): 574,
    ("ETC2", "selected_gear"): 524,
    ("ETC2", "current_gear"): 523,
    ("ETC2", "actual_gear_ratio"): 526,
    ("CCVS1", "wheel_based_speed_kph"): 84,
    ("EBC2", "front_axle_speed_kph"): 904,
    ("LFE1", "engine_fuel_rate_l_per_h"): 183,
    ("LFE1", "instantaneous_fuel_economy_km_per_l"): 184,
    ("VDC2", "steering_wheel_angle"): 1807,
    ("VDC2", "yaw_rate"): 1808,
    ("EBC5", "xbr_acceleration_limit"): 2921,
    ("VW", "axle_weight_kg"): 582,
    ("CVW", "powered_vehicle_weight_kg"): 1585,
    ("CVW", "gross_combination_weight_kg"): 1760,
}


def layout(row):
    return layouts().get_message_by_name(row.message).get_signal_by_name(row.signal)


def numbered(rows):
    return {paper.number: paper.name for row in rows for paper in row.paper if paper.number}


def test_the_papers_four_inputs_are_the_first_controls_in_its_order():
    assert numbered(commands()) == {
        1: "PedalPos",
        2: "XBR1_ExternalAccele",
        3: "XBR1_ctrl_mode",
        4: "SteerWhAngle",
    }
    controls = Truck.load(visuals=False).model
    first = [controls.actuator(i).name for i in range(4)]
    assert [row.elements[0] for row in commands() if row.paper] == first


def test_each_of_the_papers_sixteen_outputs_has_a_sensor():
    outputs = numbered(reports())
    assert sorted(outputs) == list(range(1, 17))
    # The paper names three of them.
    assert {"engine torque", "engine speed", "shift position"} <= set(outputs.values())
    assert all(row.elements for row in reports() if row.paper)


def test_every_reported_quantity_is_computed_and_every_field_of_the_truck_is_sent():
    known = quantities()
    assert {row.quantity for row in reports()} - set(known) == {"axle_load"}
    sent = {row.quantity for row in reports()}
    # Sent under other names, or as derived quantities.
    other = {"time", "yaw", "engine_torque", "brake_pressures", "wheel_speeds", "axle_loads"}
    other |= {"clutch_engagement", "xbr_mode", "xbr_active", "transmission_mode"}
    other |= {"engine_brake_torque", "retarder_torque"}
    other.add("steering_wheel_torque")  # no signal of the standard
    # The bus describes the first coupling only.
    other |= {"rear_articulations", "rear_articulation_rates"}
    fields = {*EgoState.__slots__, *TruckReport.__slots__}
    assert fields - sent == other
    assert [row.quantity for row in commands()] == list(VehicleCommand.__slots__)


@pytest.mark.parametrize(("name", "wanted"), STANDARD.items())
def test_priorities_and_addresses_are_those_of_j1939(name, wanted):
    frame = encode(group_type(name)())
    assert (frame.priority, frame.source) == wanted


def test_own_messages_have_the_priority_of_control():
    for name in message_names():
        if name.startswith("IITS_"):
            assert Frame(layouts().get_message_by_name(name).frame_id, b"").priority == 3


@pytest.mark.parametrize(("signal", "spn"), SPNS.items())
def test_suspect_parameter_numbers_are_the_standard_ones(signal, spn):
    message, name = signal
    assert layouts().get_message_by_name(message).get_signal_by_name(name).spn == spn


def test_only_our_own_signals_lack_a_suspect_parameter_number():
    for row in (*commands(), *reports()):
        assert bool(layout(row).spn) is not row.message.startswith("IITS_"), row


def test_engine_and_driveline_report_their_retarders_from_their_own_addresses():
    assert {sender(row) for row in reports() if row.message == "ERC1"} == {0x0F, 0x10}
    assert {row.address for row in commands() if row.message == "TSC1"} == {0x0F, 0x10}


def table_of_page(name):
    """Cells of a table of the manual page, row by row, without its head."""
    page = PAGE.read_text(encoding="utf-8")
    _, _, rest = page.partition(f"<!-- begin {name} -->\n")
    lines = rest.partition("<!-- end")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.mark.parametrize(("name", "rows"), [("commands", commands()), ("reports", reports())])
def test_the_manual_page_has_every_row_with_signal_number_and_elements(name, rows):
    lines = table_of_page(name)
    assert len(lines) == len(rows)
    for row, cells in zip(rows, lines, strict=True):
        assert f"`{row.message}`, `{row.signal}`" in cells
        assert str(layout(row).spn or "own") in cells
        if row.elements:
            named = next(cell for cell in cells if f"`{row.elements[0]}`" in cell)
            assert f"`{row.elements[-1]}`" in named


def test_the_manual_page_has_the_papers_inputs_and_outputs_in_order():
    lines = table_of_page("paper")
    wanted = [("in", number) for number in range(1, 5)] + [("out", n) for n in range(1, 17)]
    found = dict.fromkeys(tuple(cells[0].split()) for cells in lines if cells[0] != "more")
    assert [(way, int(number)) for way, number in found] == wanted


def test_the_manual_page_lists_exactly_the_unavailable_signals():
    silent = {
        cells[0].strip("`"): set(cells[1].replace("`", "").split(", "))
        for cells in table_of_page("silent")
    }
    for message in {row.message for row in reports()}:
        sent = {row.signal for row in reports() if row.message == message}
        sent |= {"axle_location"} if message == "VW" else set()
        names = {signal.name for signal in layouts().get_message_by_name(message).signals}
        assert silent.get(message, set()) == names - sent


def test_every_row_of_the_table_has_nine_cells_and_one_of_two_ways():
    text = (PAGE.parent / "signals.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = list(csv.reader(lines))
    assert {len(row) for row in rows} == {9}
    assert {row[0] for row in rows[1:]} == {"in", "out"}
    assert len(rows) - 1 == len(commands()) + len(reports())


def test_every_signal_of_the_table_can_be_sent():
    for row in (*commands(), *reports()):
        assert encode(make_group(row.message, {row.signal: layout(row).offset})).pgn == pgn_of(
            row.message
        )
