"""The curriculum in other people's loops.

Each module needs its library, and none is loaded before it is used.
"""
