"""What decides and steers: knows messages and roads, never MuJoCo or SUMO."""
