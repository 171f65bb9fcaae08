"""Mirror: the nearest vehicles as mocap bodies in the truck's MuJoCo model."""
