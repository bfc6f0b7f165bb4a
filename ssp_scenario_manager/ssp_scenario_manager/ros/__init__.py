"""Nodes, endpoints and clients of the manager: the only folder that imports rclpy and messages."""
