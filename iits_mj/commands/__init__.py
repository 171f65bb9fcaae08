"""The commands of `iits-mj`, one module each: `Options` (a frozen dataclass) and `run(options)`."""
