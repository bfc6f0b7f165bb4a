"""Tables and statistics over scored cells: means, ranks, intervals, comparisons, sensitivity."""
