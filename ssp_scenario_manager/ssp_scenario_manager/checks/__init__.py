"""The checks of a K* (METHOD 1): form, C1 to C5 and the review state."""
