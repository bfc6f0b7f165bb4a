"""The parts that each target adds (METHOD 2.5): SUMO, track sheet, OpenSCENARIO, OpenDRIVE,
CARLA.
"""
