"""Alpamayo 1.5 behind HTTP: the real package and weights, asked as their own test script asks them.

    python alpamayo_sidecar.py                  # front camera alone, port 8301

In: the newest 4 frames at 10 Hz and 16 poses at 10 Hz, the last one the origin. Out: `pred_xyz` as
it is, of shape (1, sets, samples, 64, 3), and the texts of `extra`; the answer's text is the chain
of causation of the first sample.

`--loader module:function` puts something else in the place of the weights: the function is given
the arguments and gives `sample(images, xyz, rot) -> (pred_xyz, pred_rot, extra)` with images
(4, 3, height, width) uint8, xyz (1, 1, 16, 3) and rot (1, 1, 16, 3, 3) float32.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from typing import Any

from sidecar_io import decode_jpeg, first_text, jpegs, native_array, past_poses, texts
from sidecar_service import Answerer, Json, LoadError, first_line, parser, serve

PORT = 8301
FRAMES = 4
POSES = 16
STEP_S = 0.1
FRAME_TOLERANCE_S = 0.03
FRONT_CAMERA = 1  # the index of the wide front camera in the package's own tables
WEIGHTS = "nvidia/Alpamayo-1.5-10B"

Sample = Callable[[Any, Any, Any], tuple[Any, Any, Json]]


def answerer(sample: Sample, facts: Json) -> Answerer:
    """Make the function of requests around a function of arrays; facts go into every answer."""
    import numpy as np

    def answer(request: Json) -> Json:
        pictures = [decode_jpeg(jpeg) for jpeg in jpegs(request, FRAMES, STEP_S, FRAME_TOLERANCE_S)]
        images = np.stack([picture.transpose(2, 0, 1) for picture in pictures])
        poses = past_poses(request, POSES, STEP_S)
        xyz = np.array([[[(x, y, 0.0) for x, y, _ in poses]]], np.float32)
        rot = np.array([[[_rotation(yaw) for _, _, yaw in poses]]], np.float32)
        pred_xyz, _, extra = sample(images, xyz, rot)
        said = {name: texts(values) for name, values in extra.items()}
        return {
            "text": first_text(said.get("cot", "")),
            "arrays": [native_array("pred_xyz", pred_xyz, "ego_xyz", "m", STEP_S, STEP_S)],
            "decoding": {**facts, "extra": said},
        }

    return answer


def _rotation(yaw_rad: float) -> list[list[float]]:
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    return [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]


def load_weights(arguments: argparse.Namespace) -> tuple[str, Sample]:
    """Load the real model: NVlabs/alpamayo1.5 f42e594."""
    try:
        import torch
        from alpamayo1_5 import helper
        from alpamayo1_5.models.alpamayo1_5 import Alpamayo1_5
    except ImportError as error:
        raise LoadError(
            f"alpamayo1_5 can't be imported by {sys.executable} ({error}); install "
            "requirements-alpamayo-1.5.txt into a Python 3.12 of its own"
        ) from error
    if not torch.cuda.is_available():
        raise LoadError("torch sees no GPU; Alpamayo needs one with at least 24 GB")
    weights = arguments.weights or WEIGHTS
    chosen = {"attn_implementation": arguments.attention} if arguments.attention else {}
    if arguments.revision:
        chosen["revision"] = arguments.revision
    try:
        model = Alpamayo1_5.from_pretrained(weights, dtype=torch.bfloat16, **chosen).to("cuda")
        processor = helper.get_processor(model.tokenizer)
    except (ImportError, OSError, ValueError) as error:
        if isinstance(error, ImportError) or "attn_implementation" in str(error):
            remedy = "start with --attention sdpa where flash-attn isn't installed"
        else:
            remedy = (
                "name a folder that is there, or the hub's weights, which are gated: ask for "
                "access on the model's page and run `hf auth login`"
            )
        raise LoadError(
            f"the weights {weights} can't be loaded ({first_line(error)}); {remedy}"
        ) from error

    def sample(images: Any, xyz: Any, rot: Any) -> tuple[Any, Any, Json]:
        frames = torch.from_numpy(images)
        camera = torch.tensor([FRONT_CAMERA])
        messages = helper.create_message(frames=frames, camera_indices=camera)
        inputs = processor.apply_chat_template(
            messages,
            tokenize=True,
            add_generation_prompt=False,
            continue_final_message=True,
            return_dict=True,
            return_tensors="pt",
        )
        data = {
            "tokenized_data": inputs,
            "ego_history_xyz": torch.from_numpy(xyz),
            "ego_history_rot": torch.from_numpy(rot),
        }
        torch.cuda.manual_seed_all(arguments.seed)
        with torch.autocast("cuda", dtype=torch.bfloat16):
            sampled: tuple[Any, Any, Json] = model.sample_trajectories_from_data_with_vlm_rollout(
                data=helper.to_device(data, "cuda"),
                top_p=arguments.top_p,
                temperature=arguments.temperature,
                num_traj_samples=arguments.samples,
                max_generation_length=arguments.max_generation_length,
                return_extra=True,
            )
        return sampled

    commit = arguments.revision or getattr(model.config, "_commit_hash", None)
    return f"{weights}@{commit}" if commit else weights, sample


def main() -> int:
    arguments_of = parser("Serves Alpamayo.", PORT)
    arguments_of.add_argument("--weights", help="folder or name on the hub")
    arguments_of.add_argument("--revision", help="commit of the weights")
    arguments_of.add_argument("--attention", help="sdpa where flash-attn isn't installed")
    arguments_of.add_argument("--samples", type=int, default=1, help="trajectories per answer")
    arguments_of.add_argument("--seed", type=int, default=42)
    arguments_of.add_argument("--temperature", type=float, default=0.6)
    arguments_of.add_argument("--top-p", type=float, default=0.98)
    arguments_of.add_argument("--max-generation-length", type=int, default=256)
    arguments = arguments_of.parse_args()
    facts = {
        "seed": arguments.seed,
        "temperature": arguments.temperature,
        "top_p": arguments.top_p,
        "num_traj_samples": arguments.samples,
        "max_generation_length": arguments.max_generation_length,
        "attention": arguments.attention or "the model's own",
        "cameras": ["front"],
    }
    return serve(arguments, load_weights, lambda sample: answerer(sample, facts))


if __name__ == "__main__":
    sys.exit(main())
