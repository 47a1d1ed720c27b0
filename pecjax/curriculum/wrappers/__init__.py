"""The curriculum in other training loops.

Each module needs its own library and is loaded only when it is used.
"""
