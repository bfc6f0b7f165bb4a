"""Figures for print (METHOD 7); matplotlib is imported only to draw."""
