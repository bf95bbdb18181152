"""Bags in and out: reading, alignment, plateaus, writing, and what is wrong with a bag."""
