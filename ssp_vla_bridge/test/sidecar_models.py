"""Stand-ins for the weights in tests of the sidecars: functions that `--loader` names.

They run in the sidecar's process, and give arrays of the real models' shapes and types.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np


def _wait_for(variable: str) -> None:
    """Wait until the file that a variable names is there; a test makes it."""
    path = os.environ.get(variable)
    deadline_s = time.monotonic() + 300.0
    while path and not Path(path).exists() and time.monotonic() < deadline_s:
        time.sleep(0.01)


def alpamayo(arguments):
    """A sampler whose samples go straight at the history's speed, each a metre further left."""
    _wait_for("LOADING")
    count = arguments.samples

    def sample(images, xyz, rot):
        kinds = (images.dtype, xyz.dtype, rot.dtype)
        if kinds != (np.uint8, np.float32, np.float32):
            raise TypeError(f"arrays of {kinds}")
        if images.shape[:2] != (4, 3) or xyz.shape != (1, 1, 16, 3):
            raise ValueError(f"shapes {images.shape} and {xyz.shape}")
        if rot.shape != (1, 1, 16, 3, 3) or abs(np.linalg.det(rot[0, 0]) - 1.0).max() > 1e-6:
            raise ValueError("no rotations")
        step_m = xyz[0, 0, -1, 0] - xyz[0, 0, -2, 0]
        pred = np.zeros((1, 1, count, 64, 3), np.float32)
        pred[0, 0, :, :, 0] = step_m * np.arange(1, 65)
        pred[0, 0, :, :, 1] = np.arange(count)[:, None]
        if os.environ.get("BROKEN") == "nan":
            pred[0, 0, 0, 3, 0] = np.nan
        if os.environ.get("BROKEN") == "raises":
            raise RuntimeError("CUDA out of memory.\nTried to allocate 2 GiB")
        pred_rot = np.zeros((1, 1, count, 64, 3, 3), np.float32)
        said = [f"Keep speed because the lane is clear ({k})." for k in range(count)]
        extra = {
            "cot": np.array(said).reshape(1, 1, count),
            "meta_action": np.array([""] * count).reshape(1, 1, count),
            "answer": np.array([""] * count).reshape(1, 1, count),
        }
        return pred, pred_rot, extra

    sample.model_id = "shapes-of-alpamayo/1"
    return sample


def llavida(arguments):
    """A generator that answers in LLaViDA's form and repeats its prompt's size."""

    def generate(image, prompt):
        return (
            f"{image.shape} {image.dtype} {prompt.count('(')}\n"
            "3-second trajectory: [(-0.1,4.0), (-0.2,8.0), (-0.3,12.0), (-0.4,16.0), "
            "(-0.5,20.0), (-0.6,24.0)]"
        )

    return generate


def struck(arguments):
    """Any function: its own thread takes a SIGTERM, as one of a model's many may."""

    def answer(request):
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
        return {"text": "", "decoding": {}}

    return answer


def _load_real(arguments, error):
    """Load the real model by the sidecar's own code, over a package of the real one's names."""
    import alpamayo_sidecar

    def fail(*_args, **_kwargs):
        raise error

    torch = types.SimpleNamespace(
        cuda=types.SimpleNamespace(is_available=lambda: True), bfloat16="bfloat16"
    )
    models = types.SimpleNamespace(Alpamayo1_5=types.SimpleNamespace(from_pretrained=fail))
    sys.modules |= {
        "torch": torch,
        "alpamayo1_5": types.SimpleNamespace(helper=None),
        "alpamayo1_5.models": types.SimpleNamespace(),
        "alpamayo1_5.models.alpamayo1_5": models,
    }
    arguments.weights = "nowhere"
    return alpamayo_sidecar.load_weights(arguments)


def weights_without_flash_attention(arguments):
    """Fail as transformers 4.57.1 does where flash-attn is asked for and isn't there."""
    words = "FlashAttention2 has been toggled on, but the package flash_attn isn't installed"
    return _load_real(arguments, ImportError(words))


def weights_of_another_attention(arguments):
    """Fail as transformers 4.57.1 does for an attention that it doesn't know."""
    return _load_real(
        arguments, ValueError('Specified `attn_implementation="wrong"` is not supported.')
    )


def weights_elsewhere(arguments):
    """Fail as the hub's client does for a folder that isn't there."""
    words = "Repo id must be in the form 'repo_name' or 'namespace/repo_name': 'nowhere'."
    return _load_real(arguments, ValueError(words))


def counting(arguments):
    """Any function: counts its calls, and works until the file in WORKING is there."""
    calls = []

    def answer(request):
        calls.append(request["request_id"])
        Path(os.environ["BEGUN"]).write_text(" ".join(calls))
        _wait_for("WORKING")
        foreign = [name for name in sys.modules if name.split(".")[0].startswith("ssp_")]
        return {"text": " ".join(calls), "decoding": {"ssp": foreign}}

    return answer


def hanging(arguments):
    """Never answers."""

    def answer(request):
        Path(os.environ["BEGUN"]).write_text("")
        while True:
            time.sleep(0.05)

    return answer


def raising(arguments):
    raise RuntimeError("the checkpoint is torn")
