"""The search for causes: signatures, fitted models, comparisons, selection, limits."""
