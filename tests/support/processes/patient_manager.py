"""The scenario_manager's process, for tests that don't judge how long recorder or world are silent.

These limits stand in no run file. Modules that read them must be imported after they are set here.
That of a world in real time stays: a live session's limit for states, which is in its run file, is
no shorter than that.
"""

from __future__ import annotations

import sys
from dataclasses import replace

from ssp_core.safety import liveness
from tests.support.processes.patience import PATIENT_S

_READERS = {"ssp_core.safety.arming", "ssp_scenario_manager.session.supervision"}
if known := _READERS & sys.modules.keys():
    raise ImportError(f"{', '.join(known)} has the narrow limits already")
for _name in ("RECORDER_SILENT_S", "CAMERA_SILENT_S", "WORLD_SILENT_LOCKSTEP_S"):
    if not hasattr(liveness, _name):
        raise ImportError(f"ssp_core.safety.liveness has no {_name}")
    setattr(liveness, _name, PATIENT_S)
liveness.RECORDER_SIGN = replace(liveness.RECORDER_SIGN, limit_s=PATIENT_S)

from ssp_scenario_manager.ros.manager_node import main  # noqa: E402

if __name__ == "__main__":
    main()
