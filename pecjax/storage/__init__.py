"""Storage: plain files and arrays on disk."""
