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
        "where the bodies of a live run's objects are",
        text="<object>=udp://<host>:<port>, <object>=iso22133://<host>:<port>?report=<file> or "
        "<object>=mirror for each object, separated by commas; empty in a simulated run",
    ),
    Parameter("autostart", True, "configure and activate at once; false: wait for commands"),
)
_MAP_FILE = Parameter(
    "map_file",
    "",
    "map that the run was compiled for, where CARLA draws or moves it",
    text="an OpenDRIVE file; the server's map must be the same",
)
SIL_WORLD = (
    RUN_FILE,
    Parameter(
        "carla",
        "",
        "CARLA server that moves the bodies of a run with the plant carla",
        text="HOST:PORT; empty for our own bodies",
    ),
    _MAP_FILE,
)
VUT_DRIVER = (
    replace(RUN_FILE, description="the run; its driver stands there"),
    Parameter(
        "answers",
        "",
        "answers that a model gave in this run before, and repeats",
        text="an answers.json; empty: the model is asked",
    ),
)
FRONT_CAMERA = (
    replace(RUN_FILE, description="the run; size, lens, rate and mount of its camera stand there"),
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
        "places of the VUT's GNSS/INS, instead of its odometry",
        text="name of a topic, sensor_msgs/NavSatFix; empty: odometry is taken",
    ),
    Parameter(
        "heading",
        "heading",
        "how it is turned, with navsat",
        text="name of a topic, sensor_msgs/Imu with an orientation against east, north, up",
    ),
    Parameter(
        "velocity",
        "",
        "its velocity, with navsat",
        text="name of a topic, geometry_msgs/TwistStamped or TwistWithCovarianceStamped; empty: "
        "speed is made of differences of places",
    ),
)
VUT_ADAPTER = (
    RUN_FILE,
    Parameter("odometry", "odometry", "what the VUT's GNSS/INS publishes", text=_TOPIC),
    *_GNSS_TOPICS,
    Parameter(
        "least_fix",
        "gbas",
        "fix type that a place must have at least; gbas: corrected from the ground, as RTK is",
        text="fix, sbas or gbas",
        pattern="fix|sbas|gbas",
    ),
    Parameter(
        "unit_forward_m",
        0.0,
        "how far the GNSS/INS sits ahead of the VUT's reference point, m",
        least=-20,
        most=20,
    ),
    Parameter(
        "unit_left_m",
        0.0,
        "how far it sits left of it, m",
        least=-20,
        most=20,
    ),
    Parameter(
        "unit_yaw_left_rad",
        0.0,
        "how far it is turned to the left against the VUT, rad",
        least=-3.15,
        most=3.15,
    ),
)
PLAYED_VUT = (
    RUN_FILE,
    Parameter("odometry", "odometry", "where the played GNSS/INS publishes", text=_TOPIC),
    *_GNSS_TOPICS,
    Parameter(
        "fix_type",
        2,
        "of the places that it publishes, by NavSatStatus's numbers",
        least=-2,
        most=2,
    ),
    Parameter("rate_hz", 100.0, "fixes a second, Hz", least=1, most=1000),
    Parameter("frame", MAP_FRAME, "of the poses; another than map is a fault", text="a frame id"),
    Parameter(
        "clock_offset_s",
        0.0,
        "how far the stamps are ahead of this host's clock, s; else than 0 it is a fault",
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
