"""Traffic lights, speed limits, closures and scripted events."""
