"""The VUT's forward camera in the software-in-the-loop world: frames, clips, contact sheets."""
