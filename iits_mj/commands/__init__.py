"""The commands of `iits-mj`: each module has a frozen dataclass `Options` and `run(options)`."""

# Commands with their purpose, by subject.
SECTIONS = {
    "drive": {
        "drive": "drive the truck in traffic; writes video, telemetry and report",
        "view": "show a drive live, in a browser or in MuJoCo's interactive viewer",
        "record": "drive in traffic and record traffic, states and commands",
        "replay": "drive in recorded traffic, or verify a recording",
        "import-trajectories": "place recorded trajectories on a map for replay",
    },
    "scenarios": {
        "sweep": "drive a scenario at many values of its parameters; map of collisions",
    },
    "look at drives": {
        "render": "draw a film or a picture of a recorded drive: other cameras, weather, sizes",
        "compare": "compare two drives: what differs, where they part, over time and station",
        "export": "write a scenario or a recorded drive as OpenSCENARIO XML, or OSI ground truth",
        "replay-stage": "run one module of a recorded drive and compare its outputs",
    },
    "CAN bus": {
        "serve": "serve the truck on a CAN bus in real time, for an external controller",
        "replay-can": "drive the truck with the commands of a CAN log, or decode the log",
    },
    "roads": {
        "road": "check a map: what is repaired, left out or refused, with a picture",
    },
    "trucks": {
        "truck": "check, show, compare and export trucks; JSON Schema of truck files",
        "identify": "fit the truck's parameters to a recorded log",
        "validate": "compare truck, traffic and planning with theory, standards and the paper",
        "montecarlo": "Monte Carlo over the uncertainty of the truck's parameters",
    },
    "planning and decisions": {
        "pcc": "plan a fuel-optimal speed profile and compare it with constant speed",
        "train": 'train the decision maker "ddqn"',
        "evaluate": "compare decision makers in the paper's traffic cells",
    },
    "installation": {
        "doctor": "check the installation and name remedies",
        "bench": "measure computing times",
        "completion": "print the completion script of a shell: bash, zsh or fish",
    },
}
COMMANDS = {name: text for section in SECTIONS.values() for name, text in section.items()}
