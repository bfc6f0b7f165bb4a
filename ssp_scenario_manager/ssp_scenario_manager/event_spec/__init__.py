"""The event specification K* (METHOD 1): model, field paths, files, log, graph and picture."""
