"""Nodes, endpoints and clients of the scenario manager: the only folder that imports rclpy and
messages.
"""
