"""Sessions in one process, without DDS: for sweeps and for machines without ROS."""
