"""Spaces: named tables of configurations, each with a part to train in and one that is held out."""
