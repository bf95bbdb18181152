"""Statistics of many sessions: rings, rigs, and changes over time. Input are results, not bags."""
