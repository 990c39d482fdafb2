"""rholoc: indoor localization by densities of visual features.

Two flows, each a straight line: recording → trajectory → observations → densities → map, and
frame → features → matches → seeds → ascent → pose.
"""

__version__ = "0.1.0"
