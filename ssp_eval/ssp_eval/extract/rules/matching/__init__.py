"""Stage 2: from the words of a text to hits: what of them means something to a rule."""
