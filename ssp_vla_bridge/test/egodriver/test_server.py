"""Our bridges behind an EgodriverService, asked by the package's loop and by our client."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import grpc  # type: ignore[import-untyped] # has no types
import pytest
from carla_driver_interface import protocol as proto
from carla_driver_interface.testing import FakeCamera, FakeLoop
from click.testing import CliRunner

from ssp_core.errors import HostError, InputError
from ssp_core.geometry import Pose2
from ssp_core.world.driver import GivenAnswer
from ssp_eval.evaluate.drivers_cli import driver
from ssp_vla_bridge.driving.driver import BridgeDriver, DriverModel
from ssp_vla_bridge.egodriver import exact
from ssp_vla_bridge.egodriver.client import EgodriverDriver
from ssp_vla_bridge.egodriver.options import read_options
from ssp_vla_bridge.egodriver.policy import BridgePolicy
from ssp_vla_bridge.egodriver.server import Listening, serving
from ssp_vla_bridge.egodriver.tls import read_certificates
from ssp_vla_bridge.window import find_interface
from tests.support.models.egodrivers import question
from tests.support.self_signed import CERTIFICATE, ENCRYPTED_KEY, KEY, OTHER_KEY

MODEL = '''
import os


def tell(request):
    """Say what is seen, and keep the speed."""
    v = request.history[-1].speed_mps
    camera = request.camera
    said = f"{camera.pitch_down_rad:.6f} {camera.height_m:.6f} {len(request.history)} {v!r}"
    return said, [(0.5 * v * k, 0.001 * k * k) for k in range(11)]


def leave(request):
    os._exit(3)


def talk(request):
    said, plan = tell(request)
    return "é" * 40_000, plan


def nothing(request):
    return ""
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("model")
    (made / "served_models.py").write_text(MODEL)
    return made


def model(backend: str, **options: Any) -> DriverModel:
    spoken = find_interface("waypoints")
    return DriverModel(
        "mine", backend, options, spoken, spoken.adapter, spoken.preprocessing, timeout_s=60.0
    )


def python(folder: Path, function: str) -> DriverModel:
    return model("python", function=f"served_models:{function}", folder=str(folder))


@contextmanager
def served(one: DriverModel, mode: Any = "alpasim", **given: Any) -> Iterator[str]:
    with serving(BridgePolicy(one, **given), mode, Listening(port=0)) as url:
        yield url


def client(url: str) -> EgodriverDriver:
    return EgodriverDriver("mine", read_options({"url": url, "deadline_s": 120.0}, "mine"))


def test_the_packages_loop_drives_the_seeing_baseline_for_200_steps() -> None:
    camera = FakeCamera(width=160, height=90, pitch_down_deg=2.0)
    with served(model("opencv_baseline")) as url, FakeLoop(url[7:], [camera]) as loop:
        loop.initial_speed_mps = 8.0
        result = loop.run(200)
    assert (result.steps, result.terminated_by_policy) == (200, False)
    ways = [float(x) for x in result.ego.positions[:, 0]]
    assert ways[-1] > 10.0
    assert all(b >= a - 1e-6 for a, b in pairwise(ways))
    assert abs(float(result.lateral_offsets_m[-1])) < 0.5


def _declare(url: str, revision: str | None, camera: proto.AvailableCamera) -> str:
    """Begin a session with a camera, ask once, and return the error or the empty text."""
    with grpc.insecure_channel(url[7:]) as channel:
        stub = proto.EgodriverServiceStub(channel)  # type: ignore[no-untyped-call] # no types
        request = proto.DriveSessionRequest(session_uuid="one")
        request.rollout_spec.vehicle.available_cameras.append(camera)
        declared = [] if revision is None else [("carla-driver-interface-contract", revision)]
        try:
            stub.start_session(request, metadata=declared)
        except grpc.RpcError as error:
            return f"{error.code().name} {error.details()}"
    return ""


@pytest.mark.parametrize(
    ("mode", "declared", "sent"),
    [
        *(("alpasim", "2", 2), ("alpasim", "1", 1), ("alpasim", None, 2)),
        *(("carla", "2", 2), ("carla", "1", 1), ("carla", None, 1)),
    ],
)
def test_a_camera_is_read_by_the_revision_that_its_client_speaks(
    mode: Any, declared: str | None, sent: int
) -> None:
    """A client that declares none is AlpaSim in its mode, and the revision before in the other."""
    fake = FakeCamera(z=1.6, pitch_down_deg=7.0, yaw_left_deg=20.0)
    policy = BridgePolicy(model("constant_velocity"))
    with serving(policy, mode, Listening(port=0)) as url:
        assert _declare(url, declared, fake.available_camera(sent)) == ""
        seat = policy.seat("one")
        assert seat is not None
        assert seat.geometry is not None
        pitch_rad, height_m = seat.geometry.pitch_down_rad, seat.geometry.height_m
    assert (pitch_rad, height_m) == pytest.approx((0.122173, 1.6), abs=1e-5)


@pytest.mark.parametrize("revision", ["3", "0", "two"])
def test_an_unknown_revision_is_refused_with_what_is_spoken(revision: str) -> None:
    with served(model("constant_velocity")) as url:
        said = _declare(url, revision, FakeCamera().available_camera())
    assert said.startswith("FAILED_PRECONDITION")
    assert revision in said


def test_a_camera_by_which_no_bridge_sees_is_refused() -> None:
    bent = FakeCamera().available_camera()
    bent.intrinsics.opencv_pinhole_param.radial_coeffs.append(0.2)
    with served(model("constant_velocity")) as url:
        assert "is distorted" in _declare(url, "2", bent)
    with served(model("constant_velocity"), camera="rear") as url:
        assert "no camera 'rear'" in _declare(url, "2", FakeCamera().available_camera())


def test_a_client_of_ours_gets_the_plan_and_the_text_to_the_last_bit(folder: Path) -> None:
    asked = [question(k + 1, speed_mps=10.1) for k in range(3)]
    one = python(folder, "tell")
    direct = BridgeDriver(one)
    wanted = [direct.give(each) for each in asked]
    direct.close()
    with served(one) as url:
        mine = client(url)
        got = [mine.give(each) for each in asked]
        mine.close()
    for a, b in zip(wanted, got, strict=True):
        assert a.answer is not None
        assert b.answer is not None
        assert a.answer.trajectory == b.answer.trajectory
        assert (a.answer.text, a.answer.refused) == (b.answer.text, b.answer.refused)


def test_a_text_that_is_too_long_for_a_message_leaves_the_plan_as_it_is(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = python(folder, "talk")
    direct = BridgeDriver(one)
    wanted = direct.give(question(speed_mps=10.1)).answer
    direct.close()
    with served(one) as url:
        mine = EgodriverDriver("talker", read_options({"url": url, "deadline_s": 120.0}, "talker"))
        got = mine.give(question(speed_mps=10.1)).answer
        mine.close()
    assert wanted is not None
    assert got is not None
    assert (got.trajectory, got.text) == (wanted.trajectory, "")
    assert len(wanted.text) == 40_000
    assert "talker: the text beside its plans is left out: 80000 bytes" in capsys.readouterr().err


def test_values_to_the_last_bit_that_are_not_the_messages_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack = exact.pack_motion
    with served(python(folder, "tell")) as url:
        mine = client(url)
        monkeypatch.setattr(exact, "pack_motion", lambda samples: pack([*samples[:-1], samples[0]]))
        got = mine.give(question())
        mine.close()
    assert "isn't that of its messages" in got.ended


@pytest.mark.parametrize(
    ("function", "ended", "refused"),
    [("leave", "its process ended with exit status 3", ""), ("nothing", "", "not_ready")],
)
def test_a_model_that_ends_or_says_nothing_does_so_for_the_client(
    folder: Path, function: str, ended: str, refused: str
) -> None:
    with served(python(folder, function)) as url:
        mine = client(url)
        got = mine.give(question())
        mine.close()
    assert ended in got.ended
    assert bool(got.ended) == bool(ended)
    assert (got.answer.refused if got.answer else "") == refused


def test_tls_by_file_and_plain_text_on_loopback_alone(tmp_path: Path) -> None:
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    certificate.write_text(CERTIFICATE)
    key.write_text(KEY)
    policy = BridgePolicy(model("constant_velocity"))
    secure = Listening(port=0, certificate=str(certificate), key=str(key))
    with serving(policy, "alpasim", secure) as url:
        given = {"url": url, "tls": str(certificate), "deadline_s": 120.0}
        checked = EgodriverDriver("mine", read_options(given, "mine"))
        answer = checked.give(question()).answer
        checked.close()
        assert answer is not None
        assert answer.trajectory is not None
        assert "UNAVAILABLE" in client(url).problem
    with (
        pytest.raises(InputError, match="--insecure"),
        serving(policy, "alpasim", Listening(host="0.0.0.0", port=0)),
    ):
        pass


def test_a_port_that_another_server_has_is_not_shared() -> None:
    with served(model("constant_velocity")) as url:
        taken = Listening(port=int(url.rpartition(":")[2]))
        policy = BridgePolicy(model("constant_velocity"))
        why = "Address already in use; give another --port"
        with pytest.raises(HostError, match=why), serving(policy, "alpasim", taken):
            pass


@pytest.mark.parametrize(
    ("host", "why"),
    [
        ("192.0.2.1", "Cannot assign requested address; give another --host"),
        ("x..y", "'x..y' is no name of a host; give another --host"),
    ],
)
def test_a_host_that_is_not_this_machine_is_told_as_such(host: str, why: str) -> None:
    policy = BridgePolicy(model("constant_velocity"))
    there = Listening(host=host, port=0, insecure=True)
    with pytest.raises(HostError, match=why), serving(policy, "alpasim", there):
        pass


@pytest.mark.parametrize(
    ("certificate", "key", "why"),
    [
        ("none", KEY, r"--tls-certificate: can't be read: No such file .*none\.pem"),
        (CERTIFICATE, "none", r"--tls-key: can't be read: No such file .*none\.pem"),
        (KEY, KEY, "--tls-certificate: holds no certificate that can be read"),
        (CERTIFICATE.replace("A", "B"), KEY, "--tls-certificate: holds no certificate"),
        (CERTIFICATE, CERTIFICATE, "--tls-key: holds no key that can be read .*; name the file"),
        (CERTIFICATE, OTHER_KEY, r"--tls-key: isn't the key of .*certificate\.pem"),
        (CERTIFICATE, ENCRYPTED_KEY, "--tls-key: is encrypted .*; store it without a passphrase"),
    ],
)
def test_a_wrong_certificate_or_key_is_named(
    certificate: str, key: str, why: str, tmp_path: Path
) -> None:
    paths = []
    for name, text in (("certificate", certificate), ("key", key)):
        paths.append(tmp_path / f"{'none' if text == 'none' else name}.pem")
        if text != "none":
            paths[-1].write_text(text)
    at = Listening(port=0, certificate=str(paths[0]), key=str(paths[1]))
    with (
        pytest.raises(InputError, match=why),
        serving(BridgePolicy(model("constant_velocity")), "alpasim", at),
    ):
        pass


def test_a_certificate_in_a_named_pipe_is_refused(tmp_path: Path) -> None:
    """No process may ever write to it."""
    pipe = tmp_path / "pipe.pem"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match=r"pipe\.pem: is a named pipe"):
        read_certificates(str(pipe), "--tls")


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (["perfect"], "answers from labels"),
        (["nothing"], "is no driver"),
        (['x={"backend": "egodriver", "url": "grpc://127.0.0.1:1"}'], "is served already"),
        (["opencv_baseline", "--host", "0.0.0.0"], "isn't loopback"),
        (["opencv_baseline", "--tls-key", "k.pem"], "go together"),
    ],
)
def test_what_can_not_be_served_is_refused(given: list[str], why: str) -> None:
    done = CliRunner().invoke(driver, ["serve", *given])
    assert done.exit_code != 0
    assert why in done.output + str(done.exception)


def test_eight_drivers_at_once_each_get_their_own_answers(folder: Path) -> None:
    begun = threading.Barrier(8, timeout=500.0)

    def drive(k: int) -> list[GivenAnswer]:
        mine = client(url)
        begun.wait()
        place = Pose2(1000.0 * k, -500.0 * k, 0.3 * k)
        asked = [question(n + 1, speed_mps=5.0 + k, pose=place) for n in range(4)]
        got = [mine.give(each) for each in asked]
        mine.close()
        return got

    with served(python(folder, "tell")) as url, ThreadPoolExecutor(8) as pool:
        found = list(pool.map(drive, range(8)))
        ninth = [client(url) for _ in range(9)]
        said = [one.give(question(seed=k)).ended for k, one in enumerate(ninth)]
        for one in ninth:
            one.close()
    for k, answers in enumerate(found):
        for one in answers:
            assert one.answer is not None, one.ended
            assert one.answer.text.endswith(f" {5.0 + k!r}")
            assert one.answer.trajectory is not None
            assert one.answer.trajectory.x_m[2] == 5.0 + k
    assert said[:8] == [""] * 8
    assert "8 sessions already" in said[8]
