"""Parameters of this package's nodes."""

from __future__ import annotations

from dataclasses import replace

from ssp_core.names import MAP_FRAME
from ssp_core.node_interface import RUN_FILE, Parameter

_TOPIC = "name of a topic; nav_msgs/Odometry"
OBJECT_TARGET = (
    RUN_FILE,
    Parameter(
        "object_ids",
        "",
        "objects of this process; empty: all of the run",
        text="ids of the run's objects, separated by commas",
    ),
    Parameter(
        "bodies",
        "",
        "addresses of the bodies of a live run's objects",
        text="<object>=udp://<host>:<port>, <object>=iso22133://<host>:<port>?report=<file> or "
        "<object>=mirror for each object, separated by commas; empty in a simulated run",
    ),
    Parameter("autostart", True, "configure and activate at once; false: wait for commands"),
)
_MAP_FILE = Parameter(
    "map_file",
    "",
    "map that the run was compiled for, if CARLA draws or moves it",
    text="an OpenDRIVE file; the server's map must be the same",
)
SIL_WORLD = (
    RUN_FILE,
    Parameter(
        "carla",
        "",
        "CARLA server that moves the bodies of a run with the plant carla",
        text="HOST:PORT; empty for SSP's own bodies",
    ),
    _MAP_FILE,
)
VUT_DRIVER = (
    replace(RUN_FILE, description="the run, which configures its driver"),
    Parameter(
        "answers",
        "",
        "answers that a model gave in an earlier session of this run, to be repeated",
        text="an answers.json; empty: the model is asked",
    ),
)
FRONT_CAMERA = (
    replace(RUN_FILE, description="the run, which gives size, lens, rate and mount of its camera"),
    Parameter(
        "carla",
        "",
        "CARLA server that draws the pictures of a run whose camera has the renderer carla",
        text="HOST:PORT; empty for the renderer raster",
    ),
    _MAP_FILE,
)
_GNSS_TOPICS = (
    Parameter(
        "navsat",
        "",
        "positions of the VUT's GNSS/INS, instead of its odometry",
        text="name of a topic, sensor_msgs/NavSatFix; empty: odometry is used",
    ),
    Parameter(
        "heading",
        "heading",
        "its orientation, with navsat",
        text="name of a topic, sensor_msgs/Imu with an orientation against east, north, up",
    ),
    Parameter(
        "velocity",
        "",
        "its velocity, with navsat",
        text="name of a topic, geometry_msgs/TwistStamped or TwistWithCovarianceStamped; empty: "
        "speed is computed from position differences",
    ),
)
VUT_ADAPTER = (
    RUN_FILE,
    Parameter("odometry", "odometry", "odometry of the VUT's GNSS/INS", text=_TOPIC),
    *_GNSS_TOPICS,
    Parameter(
        "least_fix",
        "gbas",
        "least fix type of a position; gbas: ground-based corrections, such as RTK",
        text="fix, sbas or gbas",
        pattern="fix|sbas|gbas",
    ),
    Parameter(
        "unit_forward_m",
        0.0,
        "distance of the GNSS/INS ahead of the VUT's reference point, m",
        least=-20,
        most=20,
    ),
    Parameter(
        "unit_left_m",
        0.0,
        "distance of the GNSS/INS to the left of that point, m",
        least=-20,
        most=20,
    ),
    Parameter(
        "unit_yaw_left_rad",
        0.0,
        "rotation of the GNSS/INS to the left against the VUT, rad",
        least=-3.15,
        most=3.15,
    ),
)
PLAYED_VUT = (
    RUN_FILE,
    Parameter("odometry", "odometry", "odometry of the simulated GNSS/INS", text=_TOPIC),
    *_GNSS_TOPICS,
    Parameter(
        "fix_type",
        2,
        "fix type of the published positions, as numbered in NavSatStatus",
        least=-2,
        most=2,
    ),
    Parameter("rate_hz", 100.0, "rate of fixes, Hz", least=1, most=1000),
    Parameter("frame", MAP_FRAME, "frame of the poses; any but map is a fault", text="a frame id"),
    Parameter(
        "clock_offset_s",
        0.0,
        "offset of the stamps ahead of this host's clock, s; any but 0 is a fault",
        least=-3600,
        most=3600,
    ),
)
PLAYED_CAMERA = PLAYED_BODIES = (RUN_FILE,)
NODES = {
    "object_target": OBJECT_TARGET,
    "sil_world": SIL_WORLD,
    "vut_driver": VUT_DRIVER,
    "front_camera": FRONT_CAMERA,
    "vut_adapter": VUT_ADAPTER,
    "played_vut": PLAYED_VUT,
    "played_camera": PLAYED_CAMERA,
    "played_bodies": PLAYED_BODIES,
}
