"""Colours of the built-in scenes' pictures."""

# Okabe and Ito's eight colours, told apart with any colour vision (jfly.uni-koeln.de/color, 2008),
# the yellow left out for it is faint on white.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#56b4e9", "#e69f00")
