"""Records drives to files and replays them."""
