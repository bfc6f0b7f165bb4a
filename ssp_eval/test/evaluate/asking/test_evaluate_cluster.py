"""Campaigns on a cluster of Ray: one is joined or started, and what fails is one line."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest

from ssp_core.errors import HostError
from ssp_core.host.ray_cluster import ADDRESS, import_ray, joined, look_for
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.executors import Settings
from ssp_eval.evaluate.run import run_parallel


def test_a_cluster_that_isn_t_there_is_named_before_anything_is_asked(
    make_bag: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket() as bound:  # bound and not listening: whoever calls is refused
        bound.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{bound.getsockname()[1]}"
        monkeypatch.setenv(ADDRESS, address)
        bags, models = [(make_bag(), None)], [bridge_spec("constant_velocity")]
        with pytest.raises(HostError, match=f"no Ray cluster answers at {address} .*refused"):
            run_parallel(bags, models, Settings(tmp_path), 1, "ray", True)
    assert not list(tmp_path.rglob("cell.json"))


@pytest.mark.parametrize("address", ["nowhere", "nowhere:", ":6379", "host:port", "host:65536"])
def test_what_is_no_address_is_said_at_once(address: str) -> None:
    with pytest.raises(HostError, match=f"RAY_ADDRESS={address} is no address"):
        look_for(address)


@pytest.mark.parametrize("name", ["ssp_core/__init__.py", "click.py"])
def test_a_folder_whose_code_would_run_in_the_workers_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    ray = MagicMock(is_initialized=lambda: False)
    ray.exceptions.RayError = RuntimeError
    monkeypatch.delenv(ADDRESS, raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_model.py").touch()
    (tmp_path / "ssp_core").mkdir()
    (tmp_path / "gone.py").symlink_to("nowhere")
    with joined(ray, 1):
        assert ray.init.call_count == 1
    (tmp_path / name).touch()
    with pytest.raises(HostError, match=f"{name} would run in Ray's workers"), joined(ray, 1):
        pass
    assert ray.init.call_count == 1


def test_who_listens_is_asked_by_ray_itself() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        look_for(f"ray://127.0.0.1:{server.getsockname()[1]}")


@pytest.mark.programs
def test_a_cluster_is_joined_and_one_that_fails_is_one_line() -> None:
    ray = import_ray()
    with joined(ray, 1):
        address = ray.get_runtime_context().gcs_address
        look_for(address)
        with pytest.raises(HostError, match=r"Ray cluster failed .*give the same command"):
            _ask_in_vain(ray)
    assert not ray.is_initialized()


class _Idle:
    def hello(self) -> None:
        """Does nothing."""


def _ask_in_vain(ray: Any) -> None:
    """Asks an actor that is gone."""
    with joined(ray, 1):
        actor = ray.remote(num_cpus=1)(_Idle).remote()
        ray.kill(actor)
        ray.get(actor.hello.remote())
