"""Drives as ROS 2 bags (MCAP): what the modules said to each other, topic by topic.

Foxglove, `ros2 bag` and any MCAP reader open them; `iits_mj.bag.stages` runs one module again on
what it was told, and compares what it says. Needs rosbags: pip install 'iits-mj[ros]'.
"""
