"""Serves a language model over OpenAI's chat interface on loopback, until its input ends.

Usage: server.py PACKAGES MODEL.gguf. It prints its address up to and with ``/v1`` once it listens.
"""

from __future__ import annotations

import os
import sys


def serve(packages: str, weights: str) -> None:
    sys.path.insert(0, packages)
    import xllamacpp

    params = xllamacpp.CommonParams()
    params.model.path = weights
    params.model_alias = {os.path.basename(weights)}
    params.port = 0
    params.ui = False
    params.n_ctx = 8192
    params.n_parallel = 1  # one question at a time, so that the same one has the same answer
    # Threads of llama.cpp wait for each other: on a busy machine fewer of them are faster.
    threads = max(1, (os.cpu_count() or 1) // 2)
    params.cpuparams.n_threads = params.cpuparams_batch.n_threads = threads
    server = xllamacpp.Server(params)
    print(f"{server.listening_address}/v1", flush=True)
    sys.stdin.read()
    os._exit(0)  # its threads would go on


if __name__ == "__main__":
    serve(*sys.argv[1:])
