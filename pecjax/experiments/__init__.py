"""Experiments: what a person runs."""
