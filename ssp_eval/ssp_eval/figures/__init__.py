"""Figures for print and overlays on frames (METHOD 7); matplotlib is imported only to draw."""
