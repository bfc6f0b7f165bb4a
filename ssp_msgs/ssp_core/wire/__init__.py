"""The hot messages straight between bytes and the dataclasses of the cores, without rclpy."""
