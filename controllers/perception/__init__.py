"""Perception: tracks of other road users from the detections of radars and cameras."""
