"""The session: its states and commands, the run, and the supervision of both. Without ROS, without
a clock.
"""
