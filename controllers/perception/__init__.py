"""Perception: tracks of other road users from the detections of radars and cameras."""

from controllers.perception.tracker import Detection, Tracker, TrackerConfig

__all__ = ["Detection", "Tracker", "TrackerConfig"]
