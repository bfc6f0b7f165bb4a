"""Each target's own parts (METHOD 2.5): SUMO, track sheet, OpenSCENARIO, OpenDRIVE, CARLA."""
