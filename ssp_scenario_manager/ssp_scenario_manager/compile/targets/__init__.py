"""What a target has of its own (METHOD 2.5): SUMO, track sheet, OpenSCENARIO, OpenDRIVE, CARLA."""
