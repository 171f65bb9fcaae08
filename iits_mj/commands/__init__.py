"""The commands of `iits-mj`: each module has a frozen dataclass `Options` and `run(options)`."""
