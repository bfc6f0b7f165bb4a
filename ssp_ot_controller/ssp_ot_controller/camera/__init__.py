"""The VUT's forward camera in the software-in-the-loop world: model, renderer, node, clips."""
