"""The small library that every SSP package shares; it imports without ROS."""

__version__ = "0.1.0"

# Of the rules by which imports are checked, answers are read and domains are shown. Cells and
# imports hold it. It is raised where what was made before may come out otherwise, see
# docs/updating.md.
RULES_VERSION = 2
