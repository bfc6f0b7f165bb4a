"""The vut_adapter node with places: messages in, states and what becomes of the fixes out."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from sensor_msgs.msg import Imu, NavSatFix

from ssp_core import names, ros
from ssp_core.host.environment import session_environment
from ssp_core.run_file.values import SiteDatum
from ssp_msgs import msg

pytestmark = pytest.mark.ros
DATUM = SiteDatum(latitude_deg=57.7775, longitude_deg=12.7805, altitude_m=201.3, yaw_rad=0.4)
MODULE = "ssp_ot_controller.ros.vut_adapter"


def arguments(run_file: Path, **given: str) -> list[str]:
    """Return the command line of a process of the node."""
    told = {"run_file": str(run_file), "navsat": "fix", "heading": "imu", **given}
    words = [word for name, value in told.items() for word in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", MODULE, "--ros-args", *words]


class Receiver:
    """Publishes what a receiver does of a vehicle that stands, or drives at 5 m/s."""

    def __init__(self, others: Any, twist: type) -> None:
        self.node, self.twist = others.node, twist
        pub, sub = self.node.create_publisher, self.node.create_subscription
        self.places = pub(NavSatFix, "fix", ros.STATE)
        self.headings = pub(Imu, "imu", ros.STATE)
        self.velocities = pub(twist, "vel", ros.STATE)
        self.states: list[msg.ObjectState] = []
        self.statuses: list[msg.LocalisationStatus] = []
        sub(msg.ObjectState, names.state_topic("vut"), self.states.append, ros.STATE)
        sub(msg.LocalisationStatus, names.LOCALISATION_STATUS, self.statuses.append, ros.STATE)

    def send(self, covariance_type: int = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN) -> None:
        stamp = ros.stamp_from_ns(time.time_ns())
        velocity, heading, place = self.twist(), Imu(), NavSatFix()
        for message in (velocity, heading, place):
            message.header.stamp = stamp
        twist = velocity.twist if self.twist is TwistStamped else velocity.twist.twist
        twist.linear.x, twist.linear.y = 3.0, -4.0
        self.velocities.publish(velocity)
        # Towards north-west in the site, which is turned by 0.4 rad.
        half = (0.75 * math.pi + 0.4) / 2.0
        heading.orientation.z, heading.orientation.w = math.sin(half), math.cos(half)
        self.headings.publish(heading)
        there = DATUM.datum.to_place(30.0, 40.0)
        place.latitude, place.longitude = there.latitude_deg, there.longitude_deg
        place.altitude, place.status.status = there.altitude_m, 2
        place.position_covariance[0], place.position_covariance[4] = 1e-4, 4e-4
        place.position_covariance_type = covariance_type
        self.places.publish(place)

    @property
    def reason(self) -> str | None:
        """The newest word of why there is no state; None: no word yet."""
        return self.statuses[-1].reason if self.statuses else None


@pytest.fixture
def run_file(tmp_path: Path, run_mapping: Callable[..., dict[str, Any]]) -> Path:
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps(run_mapping(mode="live", datum=DATUM.model_dump())))
    return path


@pytest.mark.parametrize("twist", [TwistStamped, TwistWithCovarianceStamped])
def test_places_headings_and_velocities_become_states(
    others: Any, domain: int, run_file: Path, tmp_path: Path, twist: type
) -> None:
    receiver = Receiver(others, twist)
    with (tmp_path / "node.txt").open("w") as log:
        node = subprocess.Popen(
            arguments(run_file, velocity="vel"),
            env=session_environment(domain),
            stdout=log,
            stderr=subprocess.STDOUT,
        )
    try:
        silent = "nothing arrives on /ssp/fix"
        others.spin_until(lambda: receiver.reason == silent, "a word on the silence")

        def driven() -> bool:
            receiver.send()
            return bool(receiver.states) and receiver.reason == ""

        others.spin_until(driven, "a state")
        state = receiver.states[-1]
        assert (state.x, state.y) == pytest.approx((30.0, 40.0), abs=1e-6)
        assert (state.yaw, state.speed) == pytest.approx((0.75 * math.pi, 5.0), abs=1e-6)
        assert state.position_std == pytest.approx(0.02)
        assert receiver.statuses[-1].used >= 1

        def approximated() -> bool:
            receiver.send(NavSatFix.COVARIANCE_TYPE_APPROXIMATED)
            return math.isinf(receiver.states[-1].position_std)

        others.spin_until(approximated, "a state without a stated deviation")
    finally:
        node.terminate()
        assert node.wait(600.0) == 0, (tmp_path / "node.txt").read_text()


def test_without_a_datum_it_says_what_is_missing(
    domain: int, tmp_path: Path, run_mapping: Callable[..., dict[str, Any]]
) -> None:
    run_file = tmp_path / "run.yaml"
    run_file.write_text(json.dumps(run_mapping(mode="live")))
    done = subprocess.run(
        arguments(run_file), env=session_environment(domain), capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "datum: is missing" in done.stderr
    assert "Traceback" not in done.stderr
