"""Parameters of this package's node."""

from __future__ import annotations

from ssp_core.node_interface import Parameter
from ssp_eval.evaluate.clients.topic_client import CONNECT_S

EVALUATOR = (
    Parameter("bags", [""], "recordings to evaluate", text="a list of bag directories"),
    Parameter(
        "models", [""], "models whose bridges run already", text="a list of names on the topics"
    ),
    Parameter(
        "models_file",
        "",
        "models whose bridges run already; all in the file count as running",
        text="path of an ssp.models/1 file, or empty",
    ),
    Parameter("out", "out/evaluation", "folder of the cells", text="path of a folder"),
    Parameter(
        "adapter",
        "",
        "reads the answers of all models; empty: each has its own",
        text="name of an adapter, or empty",
    ),
    Parameter("timeout_s", 60.0, "time limit from request to answer, s", least=0.001, most=86400),
    Parameter(
        "start_timeout_s",
        CONNECT_S,
        "time limit until all bridges are heard, s",
        least=0.001,
        most=86400,
    ),
    Parameter("retry_errors", 0, "repetitions of a request after an error", most=1000),
    Parameter(
        "controls",
        True,
        "repeat each model with spoilt frames, and run the harness's own answerers in this process",
    ),
    Parameter("pictures", False, "repeat each model with corrupted pictures"),
    Parameter("twins", False, "repeat each model on the twins beside the recordings"),
)
NODES = {"evaluator_settings": EVALUATOR}
