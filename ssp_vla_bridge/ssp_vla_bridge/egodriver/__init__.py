"""AlpaSim's EgodriverService: our client for its policies, and our bridges behind a server."""

import os

# gRPC's core writes its own lines beside the errors that are raised and told.
os.environ.setdefault("GRPC_VERBOSITY", "NONE")
