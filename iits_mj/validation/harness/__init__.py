"""Shared by all validation groups: settings, maneuvers, recorder, and kept drives."""
