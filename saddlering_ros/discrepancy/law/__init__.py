"""A law proposed for a misfit that no effect of the catalogue explains."""
