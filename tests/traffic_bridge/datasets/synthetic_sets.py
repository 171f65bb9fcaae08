"""Small computed data sets in the published formats."""

import csv

import numpy as np

FOOT = 0.3048
LANES = 3
LANE_WIDTH = 12 * FOOT
# name, length, width, NGSIM class, lane from the right, station at 0 s, speed, acceleration
VEHICLES = (
    (7, 4.5, 1.8, 2, 0, 60.0, 12.0, 0.1),
    (8, 4.8, 1.9, 2, 0, 30.0, 11.0, 0.2),
    (9, 16.0, 2.5, 3, 1, 40.0, 10.0, 0.0),
    (12, 9.0, 2.4, 3, 2, 10.0, 15.0, -0.2),
)
LEADERS = {8: 7}
SECONDS = 20.0


def tracks(step=0.1, seconds=SECONDS):
    """Rows of every vehicle: name, length, width, class, lane, time, station, speed, acceleration,
    offset in the lane; vehicle 12 changes from lane 2 to lane 1 between 8 and 12 s."""
    time = np.arange(round(seconds / step) + 1) * step
    for name, length, width, kind, lane, station, speed, acceleration in VEHICLES:
        s = station + speed * time + 0.5 * acceleration * time**2
        v = speed + acceleration * time
        across = np.full_like(time, float(lane))
        if name == 12:
            part = np.clip((time - 8.0) / 4.0, 0.0, 1.0)
            across -= part**3 * (10 + part * (6 * part - 15))
        index = np.floor(across + 0.5).astype(int)
        offset = (across - index) * LANE_WIDTH
        for k, t in enumerate(time):
            yield {
                "name": name,
                "length": length,
                "width": width,
                "class": kind,
                "lane": int(index[k]),
                "time": float(t),
                "station": float(s[k]),
                "speed": float(v[k]),
                "acceleration": acceleration,
                "offset": float(offset[k]),
                "leader": LEADERS.get(name, 0),
            }


NGSIM_HEADER = [
    *("Vehicle_ID", "Frame_ID", "Total_Frames", "Global_Time"),
    *("Local_X", "Local_Y", "Global_X", "Global_Y"),
    *("v_Length", "v_Width", "v_Class", "v_Vel", "v_Acc"),
    *("Lane_ID", "Preceding", "Following", "Space_Headway", "Time_Headway"),
]
DICTIONARY_HEADER = [
    *("Vehicle ID", "Frame ID", "Total Frames", "Global Time"),
    *("Local X", "Local Y", "Global X", "Global Y"),
    *("Vehicle Length", "Vehicle Width", "Vehicle Class"),
    *("Vehicle Velocity", "Vehicle Acceleration"),
    *("Lane Identification", "Preceding Vehicle", "Following Vehicle", "Spacing", "Headway"),
]


def ngsim_rows(scale=FOOT):
    """Rows of an NGSIM table: lane 1 is the leftmost, lengths in feet."""
    for row in tracks():
        number = LANES - row["lane"]
        frame = round(row["time"] * 10) + 100
        yield [
            row["name"],
            frame,
            201,
            1118846980200 + (frame - 100) * 100,
            round(((number - 0.5) * LANE_WIDTH - row["offset"]) / scale, 4),
            round(row["station"] / scale, 4),
            0.0,
            0.0,
            round(row["length"] / scale, 3),
            round(row["width"] / scale, 3),
            row["class"],
            round(row["speed"] / scale, 4),
            round(row["acceleration"] / scale, 4),
            number,
            row["leader"],
            0,
            0.0,
            0.0,
        ]


def write_ngsim(path, header=NGSIM_HEADER, rows=None, scale=FOOT):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(ngsim_rows(scale) if rows is None else rows)
    return path


def write_pairs(path):
    """The reconstructed pairs' schema: follower and leader of every instant in one row."""
    import pyarrow
    import pyarrow.parquet

    rows = {(row["name"], row["time"]): row for row in tracks()}
    columns = {}
    for (name, time), row in rows.items():
        if name not in LEADERS:
            continue
        ahead = rows[LEADERS[name], time]
        number = LANES - row["lane"]
        for key, value in {
            "vehicle_id": str(name),
            "frame_id": float(round(time * 10)),
            "local_x": (number - 0.5) * LANE_WIDTH - row["offset"],
            "local_y": row["station"],
            "v_length": row["length"],
            "v_width": row["width"],
            "v_class": str(row["class"]),
            "v_vel": row["speed"],
            "v_acc": row["acceleration"],
            "lane_id": str(number),
            "preceding": str(LEADERS[name]),
            "preceding_local_y": ahead["station"],
            "preceding_length": ahead["length"],
            "preceding_width": ahead["width"],
            "preceding_class": str(ahead["class"]),
            "preceding_vel": ahead["speed"],
            "preceding_acc": ahead["acceleration"],
        }.items():
            columns.setdefault(key, []).append(value)
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    return path


def write_highd(folder, direction=2):
    """A recording of 25 Hz in a section of 400 m; in direction 1 everything is mirrored."""
    folder.mkdir(exist_ok=True)
    upper, lower = [4.0 + 3.75 * k for k in range(4)], [20.0 + 3.75 * k for k in range(4)]
    ahead = 1 if direction == 2 else -1
    lines = []
    for row in tracks(step=0.04):
        # From the right: the lowest band for direction 2, the uppermost for direction 1.
        band = LANES - 1 - row["lane"] if direction == 2 else row["lane"]
        center = (lower if direction == 2 else upper)[band] + 1.875
        middle = center - ahead * row["offset"] * 3.75 / LANE_WIDTH
        left = row["station"] - row["length"] if direction == 2 else 400.0 - row["station"]
        lines.append(
            [
                round(row["time"] * 25) + 1,
                row["name"],
                left,
                middle - 0.5 * row["width"],
                row["length"],
                row["width"],
                ahead * row["speed"],
                0.0,
                ahead * row["acceleration"],
                row["leader"],
                band + (2 if direction == 1 else 6),
            ]
        )
    lines.sort(key=lambda line: line[:2])
    sizes = {row[0]: row[1:4] for row in VEHICLES}
    _write(
        folder / "01_tracks.csv",
        "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,precedingId,laneId",
        lines,
    )
    _write(
        folder / "01_tracksMeta.csv",
        "id,width,height,class,drivingDirection",
        [[n, w, h, "Truck" if c == 3 else "Car", direction] for n, (w, h, c) in sizes.items()],
    )
    _write(
        folder / "01_recordingMeta.csv",
        "id,frameRate,upperLaneMarkings,lowerLaneMarkings",
        [[1, 25, ";".join(map(str, upper)), ";".join(map(str, lower))]],
    )
    return folder / "01_tracks.csv"


def _write(path, header, rows):
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows), ""]))
