"""Shows the traffic as mocap bodies in the truck's MuJoCo model and detects contact."""
