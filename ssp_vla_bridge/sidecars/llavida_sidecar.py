"""LLaViDA behind HTTP: the repository's own model, asked as its evaluation script asks it.

    PYTHONPATH=…/LLaViDA/llavida python llavida_sidecar.py --weights …/LLaViDA-DPO-context

In: the newest frame and the request's prompt. Out: the raw text, in which the adapter `llavida`
looks for the trajectory. The prompts that the model was trained with lie in its data set and not
in its repository; the request's own is made of the task in the form that its answers have. A
user who has the data set gives its words with `--prompt FILE`, with {instruction}, {speed_mps},
{yaw_rate_radps}, {history} (the last 2 s), {lon_actions} and {lat_actions} where they belong. The
prompt's hash is in every answer.

`--loader module:function` puts something else in the place of the weights: the function is given
the arguments and gives `generate(image, prompt) -> str`, image (height, width, 3) uint8 RGB.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sidecar_io import decode_jpeg, jpegs, past_poses
from sidecar_service import (
    Answerer,
    Json,
    LoadError,
    UnanswerableError,
    first_line,
    parser,
    serve,
)

PORT = 8302
HISTORY = 5  # positions at 2 Hz: the last 2 s and now
HISTORY_STEP_S = 0.5
CONVERSATION = "llava_llama_3"
Generate = Callable[[Any, str], str]


def prompt_of(request: Json, template: str | None) -> str:
    """Return the prompt of a request, its own or the template's.

    Ours is (x forward, y left), LLaViDA's is (x right, y forward).

    Raises:
        UnanswerableError: it has none, or not what the template asks for.
    """
    if template is None:
        if not isinstance(request["prompt"], str):
            raise UnanswerableError("the request has no prompt; is its interface llavida?")
        return request["prompt"]
    poses = past_poses(request, HISTORY, HISTORY_STEP_S)
    now, task = request["history"][-1], request["task"]
    # + 0.0: a rounded -0.0 would be printed as -0.00.
    points = [(round(-y, 2) + 0.0, round(x, 2) + 0.0) for x, y, _ in poses]
    try:
        return template.format(
            instruction=task["instruction"],
            speed_mps=now["speed_mps"],
            yaw_rate_radps=now["yaw_rate_radps"],
            history="[" + ", ".join(f"({x:.2f},{y:.2f})" for x, y in points) + "]",
            lon_actions=", ".join(task["lon_actions"]),
            lat_actions=", ".join(task["lat_actions"]),
        )
    except (KeyError, IndexError, ValueError) as error:
        raise UnanswerableError(f"--prompt asks for what there isn't: {error!r}") from error


def answerer(generate: Generate, template: str | None, facts: Json) -> Answerer:
    """Make the function of requests around a function of a picture and a prompt."""

    def answer(request: Json) -> Json:
        prompt = prompt_of(request, template)
        (jpeg,) = jpegs(request, 1, 0.0, 0.0)
        digest = hashlib.sha256(prompt.encode()).hexdigest()
        return {
            "text": generate(decode_jpeg(jpeg), prompt),
            "decoding": {**facts, "prompt_sha256": f"sha256:{digest}"},
        }

    return answer


def load_weights(arguments: argparse.Namespace) -> tuple[str, Generate]:
    """Load the real model: 1999Lyd/LLaViDA 728cce7, llavida/llava/eval/model_vqa_loader.py."""
    if not arguments.weights:
        raise LoadError("--weights must name the folder of a LLaViDA checkpoint")
    try:
        import torch
        from llava.constants import (
            DEFAULT_IM_END_TOKEN,
            DEFAULT_IM_START_TOKEN,
            DEFAULT_IMAGE_TOKEN,
            IMAGE_TOKEN_INDEX,
        )
        from llava.conversation import conv_templates
        from llava.mm_utils import process_images, tokenizer_image_token
        from llava.model.builder import load_pretrained_model
        from llava.utils import disable_torch_init
        from PIL import Image
    except ImportError as error:
        raise LoadError(
            f"LLaViDA can't be imported by {sys.executable} ({error}); put the folder llavida of "
            "its repository on PYTHONPATH and install requirements-llavida.txt into a Python 3.10 "
            "of its own"
        ) from error
    if not torch.cuda.is_available():
        raise LoadError("torch sees no GPU")
    if not Path(arguments.weights).is_dir():
        raise LoadError(f"there is no folder {arguments.weights} with a checkpoint")
    disable_torch_init()
    try:
        tokenizer, model, image_processor, _ = load_pretrained_model(
            arguments.weights,
            load_4bit=arguments.precision == "4bit",
            attn_implementation=arguments.attention,
        )
    except (ImportError, OSError, ValueError) as error:
        raise LoadError(
            f"the checkpoint {arguments.weights} can't be loaded ({first_line(error)}); give "
            "--attention sdpa where flash-attn isn't installed, and --precision fp16 where 4 bits "
            "aren't to be had"
        ) from error

    def generate(image: Any, prompt: str) -> str:
        picture = Image.fromarray(image)
        token = DEFAULT_IMAGE_TOKEN
        if model.config.mm_use_im_start_end:
            token = DEFAULT_IM_START_TOKEN + DEFAULT_IMAGE_TOKEN + DEFAULT_IM_END_TOKEN
        conversation = conv_templates[CONVERSATION].copy()
        conversation.append_message(conversation.roles[0], f"{token}\n{prompt}")
        conversation.append_message(conversation.roles[1], None)
        tokens = tokenizer_image_token(
            conversation.get_prompt(), tokenizer, IMAGE_TOKEN_INDEX, return_tensors="pt"
        )
        pixels = process_images([picture], image_processor, model.config)[0]
        torch.manual_seed(arguments.seed)
        with torch.inference_mode():
            output = model.generate(
                tokens.unsqueeze(0).to("cuda"),
                images=pixels.unsqueeze(0).to(dtype=torch.float16, device="cuda"),
                image_sizes=[picture.size],
                do_sample=arguments.temperature > 0,
                temperature=arguments.temperature,
                top_p=arguments.top_p,
                num_beams=1,
                max_new_tokens=arguments.max_new_tokens,
                pad_token_id=tokenizer.pad_token_id,
                use_cache=True,
            )
        return str(tokenizer.batch_decode(output, skip_special_tokens=True)[0])

    return f"LLaViDA({Path(arguments.weights).name})", generate


def main() -> int:
    arguments_of = parser("Serves LLaViDA.", PORT)
    arguments_of.add_argument("--weights", help="folder of the checkpoint")
    arguments_of.add_argument("--prompt", help="file with the prompt's text")
    # The repository's script hands the model's name over where load_4bit stands, so that what it
    # evaluates is the model in 4 bits; its loader asks for them twice, which the transformers that
    # it pins refuses.
    arguments_of.add_argument("--precision", choices=("4bit", "fp16"), default="fp16")
    arguments_of.add_argument("--attention", default="flash_attention_2")
    arguments_of.add_argument("--seed", type=int, default=42)
    arguments_of.add_argument("--temperature", type=float, default=0.2)
    arguments_of.add_argument("--top-p", type=float, default=0.2)
    arguments_of.add_argument("--max-new-tokens", type=int, default=4096)
    arguments = arguments_of.parse_args()
    template = None
    if arguments.prompt is not None:
        try:
            template = Path(arguments.prompt).read_text("utf-8")
        except (OSError, ValueError) as error:
            print(f"error: {arguments.prompt} can't be read: {error}", file=sys.stderr)
            return 2
    facts = {
        "seed": arguments.seed,
        "temperature": arguments.temperature,
        "top_p": arguments.top_p,
        "max_new_tokens": arguments.max_new_tokens,
        "precision": arguments.precision,
        "attention": arguments.attention,
        "prompt": Path(arguments.prompt).name if arguments.prompt else "the request's",
    }
    return serve(arguments, load_weights, lambda model: answerer(model, template, facts))


if __name__ == "__main__":
    sys.exit(main())
