"""Stage 4: which hits are asserted about the present, and which are not, and why not."""
