"""Viewing: flights that were recorded, as a page for the browser or as a moving picture."""
