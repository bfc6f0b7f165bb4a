"""What an object_target sends."""
