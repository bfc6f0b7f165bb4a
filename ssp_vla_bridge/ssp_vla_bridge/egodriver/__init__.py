"""AlpaSim's EgodriverService: our client for its policies, and our bridges behind a server."""

import os

# gRPC's core writes its own lines beside the errors that are raised and told.
os.environ.setdefault("GRPC_VERBOSITY", "NONE")
# Read when gRPC is loaded. With its handlers of forks, a process that has served can hang in the
# fork by which it starts another program.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")
