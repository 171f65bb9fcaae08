"""Vehicle types, demand, car-following and lane-change models, and calibration."""
