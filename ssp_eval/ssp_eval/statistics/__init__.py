"""Statistics over scored cells: means, ranks, intervals, comparisons, sensitivity; their tables."""
