"""One-file HTML pages with tables and figures: what every report of the suite is made of.

`charts` describes a figure and draws its picture, `interactive` makes it a figure to zoom into,
`html` writes the page around them, and `certainty` draws how certain a verdict is. Nothing here
knows a ring.
"""
