"""Runtime: devices, processes, signals and where a figure came from."""
