"""Files for other simulators: OpenDRIVE maps, OpenSCENARIO XML, CARLA configurations."""
