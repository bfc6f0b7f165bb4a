"""The played camera driver."""
