"""The hot messages straight between bytes (CDR) and dataclasses, without rclpy."""
