"""Tracking: steering, pedal and brakes that make the truck follow its trajectory."""
