"""The Australian Performance-Based Standards (PBS): measures, maneuvers and limits."""
