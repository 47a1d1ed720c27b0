"""Plotting: the figures of runs and studies."""
