"""The end of an object target's process, as its test object hears it."""

from __future__ import annotations

import json
import select
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

from ssp_core import names
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.messages import CentreStatus, Heab
from ssp_ot_controller.ros.object_target import ObjectProcess
from tests.support.iso22133.messages import ObjectSockets, message_of
from tests.support.processes.waiting import until


def test_a_test_object_hears_the_abort_of_a_process_that_ends(
    tmp_path: Path, run_mapping: Callable[..., dict[str, Any]]
) -> None:
    """No timer runs any more."""
    run_file, node = tmp_path / "run.yaml", MagicMock()
    datum = {"latitude_deg": 57.0, "longitude_deg": 12.0}
    run_file.write_text(json.dumps(run_mapping(mode="live", datum=datum)))
    node.get_name.return_value = names.OBJECT_TARGET
    with ObjectSockets() as sockets:
        bodies = f"ot1=iso22133://{sockets.host}:{sockets.port}?waive=Ada"
        process = ObjectProcess(
            node, {"run_file": str(run_file), "object_ids": "", "bodies": bodies}
        )

        def attempts() -> bool:
            for timer in node.create_timer.call_args_list:
                timer.args[1]()
            return bool(select.select([sockets.tcp], [], [], 0.0)[0])

        until(attempts, "an attempt to connect")
        process.pool.target_of("ot1").state = ControlState.RUNNING
        process.halt()
        heabs = []
        while select.select([sockets.udp], [], [], 0.0)[0]:
            heabs.append(message_of(sockets.udp.recv(4096)))
        process.close()
    assert CentreStatus.ABORT in [heab.status for heab in heabs if isinstance(heab, Heab)]
