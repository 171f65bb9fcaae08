"""Drives as ROS 2 bags (MCAP): the messages between the modules, topic by topic.

Foxglove, `ros2 bag` and any MCAP reader open them. `iits_mj.bag.stages` runs one module again on
its recorded inputs, and compares its outputs. Needs rosbags: pip install 'iits-mj[ros]'.
"""
