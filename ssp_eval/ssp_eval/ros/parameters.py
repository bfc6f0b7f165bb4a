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
        "models whose bridges run already; every one in the file is taken as running",
        text="path of an ssp.models/1 file, or empty",
    ),
    Parameter("out", "out/evaluation", "where the cells are written", text="path of a folder"),
    Parameter(
        "adapter",
        "",
        "reads the answers of all models; empty: each has its own",
        text="name of an adapter, or empty",
    ),
    Parameter("timeout_s", 60.0, "from request to answer, s", least=0.001, most=86400),
    Parameter(
        "start_timeout_s", CONNECT_S, "until the bridges are heard, s", least=0.001, most=86400
    ),
    Parameter("retry_errors", 0, "how often a request is repeated after an error", most=1000),
    Parameter(
        "controls",
        True,
        "each model once more with spoilt frames, and the harness's own answerers, in this process",
    ),
    Parameter("pictures", False, "each model once more with corrupted pictures"),
    Parameter("twins", False, "each model once more about the twins beside the recordings"),
)
NODES = {"evaluator_settings": EVALUATOR}
